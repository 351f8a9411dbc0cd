"""TODO room loose_env/gap/fitting."""
