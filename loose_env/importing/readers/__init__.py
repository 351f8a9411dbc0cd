"""TODO room loose_env/importing/readers."""
