"""Sequential tests: change of transmission, stopping rule.

Data flow: transmission_change -> stopping_rule.
"""
