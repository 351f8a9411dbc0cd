"""Linearised screening of candidates, their starting points and groups.

Data flow: data_driven_starts -> screening -> grouping.
"""
