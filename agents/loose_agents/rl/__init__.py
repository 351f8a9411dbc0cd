"""Reinforcement learning: policy networks, model files, training, agents that play policies."""
