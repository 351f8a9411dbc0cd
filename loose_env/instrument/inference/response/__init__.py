"""Frequency response of an arm with nuisance parameters, and its timing.

Data flow: elastic_coordinates -> uncertain_linear_arm -> sensor_rows -> frequency_response ->
timing -> pairing.
"""
