"""Autocorrelated samples: effective sample size, block bootstrap."""
