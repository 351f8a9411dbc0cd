"""State, actions and observations of episodes.

Data flow: indices -> actions -> elements -> observation -> reset_options -> state ->
record_writer -> batch.
"""
