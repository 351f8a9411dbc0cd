"""TODO room loose_env/gap/residuals."""
