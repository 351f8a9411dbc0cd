"""TODO room loose_env/thesis/ch3_modelling."""
