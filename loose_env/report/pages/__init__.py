"""TODO room loose_env/report/pages."""
