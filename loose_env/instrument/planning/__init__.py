"""TODO room loose_env/instrument/planning."""
