"""Brakes, position servos and elastic gears at the joints.

Data flow: gears -> compliance.
"""
