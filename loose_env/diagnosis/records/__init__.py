"""Statistics, predictions and model uncertainty of single records.

Data flow: excitation_design -> model_uncertainty -> link_readings -> prediction ->
record_statistics.
"""
