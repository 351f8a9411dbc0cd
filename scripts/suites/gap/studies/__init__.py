"""Studies of `loose gap` beside its suite: edit test, calibration, cost, measured recordings."""
