"""Search in impact-dominated residuals.

Data flow: impact_power -> impact_search -> impact_pass.
"""
