"""Policies: random, constant, greedy, look-ahead, oracle, link finding.

Data flow: candidate_records -> greedy -> link_finding -> look_ahead -> random_and_constant ->
policies -> oracle -> spatial_link_finding.
"""
