"""TODO room agents/loose_agents/rl."""
