"""TODO room loose_env/statistics/sampling."""
