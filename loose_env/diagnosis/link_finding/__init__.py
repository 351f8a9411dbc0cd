"""Link finding from changes of direction, in the plane and in space.

Data flow: direction_images -> driven_joint -> planar -> spatial -> measured_direction -> moves ->
opening_moves -> pooled_scatter -> sensed_places -> seat_coverage -> search.
"""
