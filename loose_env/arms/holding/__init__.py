"""TODO room loose_env/arms/holding."""
