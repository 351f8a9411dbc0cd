"""TODO room loose_env/envs/rendering."""
