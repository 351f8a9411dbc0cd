"""TODO room agents/loose_agents/execution."""
