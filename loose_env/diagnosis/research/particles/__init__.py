"""Particle posterior with synthetic likelihoods and tempering.

Data flow: synthetic_likelihood -> tempering -> evidence.
"""
