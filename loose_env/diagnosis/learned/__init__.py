"""TODO room loose_env/diagnosis/learned."""
