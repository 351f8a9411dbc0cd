"""Policies: random, constant, greedy, look-ahead, oracle, link finding, constant baselines.

Data flow: blind -> seat_search -> classical -> local -> information_policies -> non_adaptive ->
link_finding -> policies -> oracle -> spatial_link_finding -> model_gap.
"""
