"""TODO room loose_env/envs/faults."""
