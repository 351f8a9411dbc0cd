"""Experiments on the slide.

Data flow: experiment_four -> records -> directions -> figures -> quadrature -> velocities ->
experiments_two_three.
"""
