"""Chapter 3: modelling of looseness.

Data flow: alternatives -> docked_tool -> identification -> matrices -> modelling.
"""
