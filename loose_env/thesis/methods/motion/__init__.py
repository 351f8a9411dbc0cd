"""Motion and loads of a loose planar arm, and distributions of its motion.

Data flow: histogram -> gaussian_ridge -> distribution_matching -> joint_loads ->
loose_planar_arm -> manipulability -> seat_motion -> signals.
"""
