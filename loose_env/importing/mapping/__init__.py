"""TODO room loose_env/importing/mapping."""
