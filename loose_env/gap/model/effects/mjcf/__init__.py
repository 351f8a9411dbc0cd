"""Edits of a MuJoCo spec that effects share.

Data flow: geometry -> inertia -> joint_effect -> passive_actuators -> extra_joint ->
sensor_columns -> split_body.
"""
