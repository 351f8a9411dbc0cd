"""TODO room loose_env/gap/output."""
