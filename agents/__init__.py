"""Agents that diagnose: one file an agent, all speaking stable-baselines3's ``predict``."""
