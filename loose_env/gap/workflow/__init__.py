"""The pipeline, the step-by-step session, and the summary that report and files need.

Data flow: quick_look -> pipeline -> session -> evidence -> summary -> explain.
"""
