"""TODO room loose_env/gap/simulation."""
