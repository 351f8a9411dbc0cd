"""Reinforcement learning: networks, model files, training."""
