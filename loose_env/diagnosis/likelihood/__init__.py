"""Likelihood of record statistics under each fault hypothesis, and the posterior.

Data flow: axial_likelihood -> seat_response -> record_likelihood -> opening_table -> posterior.
"""
