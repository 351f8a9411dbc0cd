"""TODO room loose_env/thesis/shared."""
