"""Grading of the tool on one case, rows and tables."""
