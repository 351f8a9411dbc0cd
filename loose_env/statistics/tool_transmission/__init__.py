"""TODO room loose_env/statistics/tool_transmission."""
