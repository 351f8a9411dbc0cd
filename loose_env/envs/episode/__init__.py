"""State, actions and observations of episodes.

Data flow: actions -> observation -> reset_options -> state -> batch.
"""
