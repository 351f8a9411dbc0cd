"""Preparation of a comparison: integrator, sensitivity to initial conditions, data needed.

Data flow: chaotic_runs -> data_sufficiency -> integrator_choice -> prepare.
"""
