"""Linearised screening of candidates, their starting points, sets of them, and quick fits.

Data flow: stiffness_starts -> data_driven_starts -> linear_problem -> grouping -> signatures ->
screening -> joint_proposals -> relinearised_sets -> window_fits.
"""
