"""Drawing of planar arms.

Data flow: view -> arm -> scene.
"""
