"""TODO room loose_env/thesis/ch5_simulation."""
