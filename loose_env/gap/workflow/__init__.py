"""The pipeline, the step-by-step session, and the summary that report and files need.

Data flow: joined_runs -> quick_look -> pipeline -> session -> evidence -> next_motion -> summary ->
explain.
"""
