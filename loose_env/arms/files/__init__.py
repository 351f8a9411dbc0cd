"""TODO room loose_env/arms/files."""
