"""TODO room loose_env/statistics/transmission."""
