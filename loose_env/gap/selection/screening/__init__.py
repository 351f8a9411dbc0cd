"""TODO room loose_env/gap/selection/screening."""
