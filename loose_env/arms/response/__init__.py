"""TODO room loose_env/arms/response."""
