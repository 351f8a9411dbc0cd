"""TODO room loose_env/instrument/model."""
