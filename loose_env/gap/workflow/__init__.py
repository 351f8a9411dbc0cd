"""TODO room loose_env/gap/workflow."""
