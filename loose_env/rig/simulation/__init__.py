"""TODO room loose_env/rig/simulation."""
