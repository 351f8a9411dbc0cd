"""Autocorrelated samples: effective sample size, block bootstrap.

Data flow: autocorrelation -> block_bootstrap -> effective_samples.
"""
