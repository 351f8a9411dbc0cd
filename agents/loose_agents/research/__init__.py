"""Pose-set policies.

Data flow: pose_set_policies -> pose_set_trials.
"""
