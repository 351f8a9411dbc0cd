"""Link finding from changes of direction, in the plane and in space.

Data flow: direction_images -> planar -> spatial -> measured_direction -> moves -> opening_moves
-> pooled_scatter -> search.
"""
