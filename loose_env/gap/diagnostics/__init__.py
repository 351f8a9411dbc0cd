"""Localisation of residuals, residual tests, identifiability, experiment advice.

Data flow: experiment_advice -> identifiability -> prediction_horizon -> regressors ->
joint_torque_residual -> residual_spectra -> localisation -> feature_localisation ->
remaining_error -> residual_tests.
"""
