"""TODO room loose_env/evaluation."""
