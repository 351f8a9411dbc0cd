"""TODO room loose_env/arms/library."""
