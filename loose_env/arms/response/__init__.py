"""Linear response of an arm to joint torques, and its nominal-model mismatch.

Data flow: open_seats -> stiffness -> linear -> mismatch -> sensor_sites -> shaken.
"""
