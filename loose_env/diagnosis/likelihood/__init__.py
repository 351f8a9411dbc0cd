"""TODO room loose_env/diagnosis/likelihood."""
