"""Studies of what the thesis left open: fits of its rig, excitation, torque alone."""
