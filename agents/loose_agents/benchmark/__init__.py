"""TODO room agents/loose_agents/benchmark."""
