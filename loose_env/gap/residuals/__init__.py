"""Residuals between simulation and measurement, their autocorrelation and windows.

Data flow: random_excitation -> residual_model -> autocorrelation -> physical_units -> windows.
"""
