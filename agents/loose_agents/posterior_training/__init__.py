"""TODO room agents/loose_agents/posterior_training."""
