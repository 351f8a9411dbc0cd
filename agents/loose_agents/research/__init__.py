"""Particle posteriors and pose-set policies.

Data flow: particle_posterior -> particle_check -> particle_calibration -> pose_set_policies ->
pose_set_trials.
"""
