"""Drawing of planar arms.

Data flow: view -> arm -> correlation_loop -> scene.
"""
