"""Drawing of arms in space.

Data flow: correlation_surface -> shapes -> view -> arm -> scene.
"""
