"""Chapter 5: simulations.

Data flow: correlation -> distribution_matching -> tool_motion -> simulations.
"""
