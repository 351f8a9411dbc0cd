"""Linearised screening of candidates, their starting points, sets of them, and quick fits.

Data flow: data_driven_starts -> linear_problem -> signatures -> screening -> grouping ->
joint_proposals -> window_fits.
"""
