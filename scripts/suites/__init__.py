"""Suites: blind recordings graded, and attempts to break the package."""
