"""Agents for the diagnosis environments: estimators, policies, training, benchmarks.

Data flow: core -> evaluation -> execution -> policies -> rl -> registry -> benchmark ->
posterior_training -> research.
"""
