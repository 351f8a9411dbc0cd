"""Agent protocol, seeds, belief agents, estimators with their tuned settings.

Data flow: seeds -> base -> ratio_posterior -> belief_agent -> estimators.
"""
