"""TODO room loose_env/thesis/ch4_diagnosis."""
