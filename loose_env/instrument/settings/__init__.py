"""TODO room loose_env/instrument/settings."""
