"""Motion and loads of a loose planar arm, and distributions of its motion.

Data flow: gaussian_ridge -> histogram -> joint_loads -> loose_planar_arm -> manipulability ->
ridge_initialisation -> distribution_matching -> seat_motion -> monte_carlo -> signals.
"""
