"""Effects of drives: gains, lags, delays, limits, dead zones, and friction under load.

Data flow: actuators -> load_friction.
"""
