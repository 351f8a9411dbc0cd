"""Learned (amortised) posterior, its features, and detection of novel input.

Data flow: features -> network -> residual_change -> novelty -> amortised_posterior.
"""
