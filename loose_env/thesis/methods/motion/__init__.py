"""Distributions of the motion of a loose planar arm.

Data flow: gaussian_ridge -> histogram -> loose_planar_arm -> ridge_initialisation ->
distribution_matching -> seat_motion -> monte_carlo -> signals.
"""
