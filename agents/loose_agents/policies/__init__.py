"""Policies: random, constant, greedy, look-ahead, oracle, link finding.

Data flow: information_policies -> link_finding -> policies -> oracle -> spatial_link_finding.
"""
