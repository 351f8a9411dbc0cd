"""TODO room scripts/agents."""
