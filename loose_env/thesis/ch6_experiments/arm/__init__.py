"""Experiment One on the large arm, and the sizing of VERA.

Data flow: guideway -> sizing_figures -> experiment_one_figures -> experiment_one -> structures ->
sizing.
"""
