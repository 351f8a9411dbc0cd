"""TODO room loose_env/gap/data."""
