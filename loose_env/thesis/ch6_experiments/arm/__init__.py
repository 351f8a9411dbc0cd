"""Experiments on the arm, and its sizing.

Data flow: guideway -> sizing_figures -> strokes -> experiment_one_figures -> experiment_one ->
structures -> sizing.
"""
