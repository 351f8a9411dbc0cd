"""Posterior over faults from spectral lines of an uncertain linear arm.

Data flow: response -> seat_motion -> variance_components -> opening_probability -> evidence ->
laplace_fit -> posterior -> findings.
"""
