"""TODO room loose_env/instrument/inference."""
