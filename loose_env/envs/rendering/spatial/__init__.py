"""Drawing of arms in space.

Data flow: view -> shapes -> arm -> scene.
"""
