"""Experiments Two, Three and Four on the slide.

Data flow: experiment_four -> records -> directions -> figures -> velocities ->
experiments_two_three.
"""
