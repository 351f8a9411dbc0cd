"""TODO room loose_env/instrument/data."""
