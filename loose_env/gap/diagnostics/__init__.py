"""TODO room loose_env/gap/diagnostics."""
