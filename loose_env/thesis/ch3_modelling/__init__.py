"""Chapter 3: modelling of looseness.

Data flow: alternatives -> docked_tool -> figures -> identification -> matrices -> modelling.
"""
