"""Suites run by hand: blind recordings graded, golden results, fuzzed, killed and long runs."""
