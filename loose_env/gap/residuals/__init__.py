"""Residuals between simulation and measurement, their autocorrelation and windows.

Data flow: progress -> random_excitation -> residual_model -> autocorrelation ->
physical_units -> windows -> preparation.
"""
