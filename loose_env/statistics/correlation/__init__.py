"""Correlation and coherence of tool motion with the excitation, by direction.

Data flow: by_direction -> coherence -> comparative_index
-> delay.
"""
