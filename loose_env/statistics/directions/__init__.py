"""Axial directions in the plane and in space.

Data flow: angle_information -> angles -> sphere.
"""
