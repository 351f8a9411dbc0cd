"""TODO room loose_env/envs/episode."""
