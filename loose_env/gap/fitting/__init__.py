"""Gauss-Newton fits, held-out scores, confidence intervals, profile bounds.

Data flow: initial_state -> model_structure -> gauss_newton ->
confidence_intervals -> holdout_score -> refit -> profile_bounds.
"""
