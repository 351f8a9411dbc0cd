"""Evaluation of agents on hidden faults, and bounds on records.

Data flow: env_arguments -> evaluate -> record_bounds.
"""
