"""TODO room loose_env/gap/preparation."""
