"""Agent protocol, belief tracking, estimators, shipped weights.

Data flow: base -> belief_agent -> belief_tracker -> shipped_weights -> estimators.
"""
