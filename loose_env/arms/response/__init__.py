"""Linear response of an arm to joint torques, and its nominal-model mismatch.

Data flow: linear -> mismatch -> sensor_sites -> shaken.
"""
