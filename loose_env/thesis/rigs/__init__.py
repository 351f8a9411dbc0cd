"""TODO room loose_env/thesis/rigs."""
