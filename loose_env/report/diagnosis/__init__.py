"""TODO room loose_env/report/diagnosis."""
