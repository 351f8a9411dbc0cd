"""Posterior over faults from spectral lines of an uncertain linear arm.

Data flow: uncertain_linear_arm -> frequency_response -> opening_probability -> evidence ->
laplace_fit -> posterior -> correlation_loops -> direction_cones -> free_travel -> warnings.
"""
