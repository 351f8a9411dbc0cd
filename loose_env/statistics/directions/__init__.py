"""Axial directions in the plane and in space.

Data flow: angles -> sphere.
"""
