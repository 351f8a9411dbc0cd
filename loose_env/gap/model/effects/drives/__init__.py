"""Effects of drives: gains, lags, delays, limits, dead zones, and friction under load.

Data flow: actuators -> torque_constant -> limits -> dead_zone -> load_friction.
"""
