"""Transmission from joints to tool: estimate, change, direction and rank of the change.

Data flow: change -> estimate -> axis_misfit -> direction -> rank.
"""
