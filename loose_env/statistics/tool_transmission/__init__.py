"""Transmission from joints to tool: estimate, change, direction and rank of the change."""
