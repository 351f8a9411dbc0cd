"""Agent protocol, seeds, belief agents, estimators with their tuned settings.

Data flow: seeds -> base -> belief_agent -> estimators.
"""
