"""Covariances, moments and spectra of a record.

Data flow: covariance -> moments -> spectra.
"""
