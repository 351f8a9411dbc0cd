"""State, actions and observations of episodes.

Data flow: actions -> elements -> observation -> reset_options -> state -> record_writer -> batch.
"""
