"""Confidence intervals of directions, and the record length they need.

Data flow: axis -> direction -> record_length.
"""
