"""TODO room loose_env/statistics/correlation."""
