"""TODO room loose_env/report/gap."""
