"""TODO room loose_env/statistics/records."""
