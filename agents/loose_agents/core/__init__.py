"""TODO room agents/loose_agents/core."""
