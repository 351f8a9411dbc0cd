"""Checks of readings against the model and against each other: units, signs, axes, clocks.

Data flow: units -> by_run -> encoders -> positions -> motion -> forces -> torque_fit ->
model_errors -> alternatives -> gravity -> clocks.
"""
