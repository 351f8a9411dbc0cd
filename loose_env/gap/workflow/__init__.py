"""The pipeline, the step-by-step session, and the summary that report and files need.

Data flow: pipeline -> session -> evidence -> summary -> explain.
"""
