"""TODO room loose_env/importing/timing."""
