"""Posterior over faults from spectral lines of an uncertain linear arm.

Data flow: uncertain_linear_arm -> frequency_response -> timing -> variance_components ->
opening_probability -> evidence -> laplace_fit -> posterior -> correlation_loops ->
direction_cones -> free_travel -> verdict -> warnings.
"""
