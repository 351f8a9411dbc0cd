"""Robustness of the commands on generated arms and recordings."""
