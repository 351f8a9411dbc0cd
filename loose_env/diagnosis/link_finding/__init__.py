"""TODO room loose_env/diagnosis/link_finding."""
