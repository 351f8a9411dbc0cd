"""Agents of loose_env/Gap-v0: evaluation and training."""
