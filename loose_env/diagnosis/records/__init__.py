"""TODO room loose_env/diagnosis/records."""
