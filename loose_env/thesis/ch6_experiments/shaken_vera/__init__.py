"""Experiments on VERA with its shaker.

Data flow: cases -> tables -> figures -> experiment_six -> looseness_tables -> experiment_five.
"""
