"""TODO room loose_env/kinematics."""
