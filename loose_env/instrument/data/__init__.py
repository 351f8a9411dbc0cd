"""Held poses, dropouts, sensors and spectral lines of a recording.

Data flow: dropouts -> held_pose -> sensor_noise -> sensor_selection
-> spectral_lines -> paired_runs.
"""
