"""Runs cut at pauses, aligned runs, hold-out split, noise floor, initial rest, smoothing.

Data flow: measured_runs -> actuator_states -> holdout_split -> initial_rest ->
aligned_run -> motion_band -> smoothing.
"""
