"""Pictures of an episode.

Data flow: correlation -> fault_text -> palette -> caption -> scenery -> planar -> spatial ->
picture.
"""
