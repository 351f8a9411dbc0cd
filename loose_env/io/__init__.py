"""TODO room loose_env/io."""
