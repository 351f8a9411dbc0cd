"""TODO room loose_env/report/comparison."""
