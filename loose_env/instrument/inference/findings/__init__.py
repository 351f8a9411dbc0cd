"""Directions, free travel, verdict and warnings by the posterior.

Data flow: correlation_loops -> direction_cones -> free_travel -> verdict -> warnings.
"""
