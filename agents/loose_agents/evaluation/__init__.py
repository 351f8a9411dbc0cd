"""TODO room agents/loose_agents/evaluation."""
