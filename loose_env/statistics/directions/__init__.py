"""TODO room loose_env/statistics/directions."""
