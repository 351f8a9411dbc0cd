"""TODO room loose_env/statistics/intervals."""
