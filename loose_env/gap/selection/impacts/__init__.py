"""TODO room loose_env/gap/selection/impacts."""
