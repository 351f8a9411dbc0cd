"""Pictures of an episode.

Data flow: correlation_loop -> correlation_surface -> fault_text -> palette -> caption ->
scenery -> planar -> spatial -> picture.
"""
