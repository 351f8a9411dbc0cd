"""TODO room loose_env/diagnosis/research/pose_sets."""
