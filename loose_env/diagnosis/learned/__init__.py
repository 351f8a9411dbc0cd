"""Learned (amortised) posterior, its features, and detection of novel input.

Data flow: transmission_change -> features -> network -> residual_change -> novelty ->
amortised_posterior.
"""
