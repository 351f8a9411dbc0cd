"""Experiments Five and Six: VERA on its shaker.

Data flow: cases -> tables -> figures -> experiment_six -> experiment_five.
"""
