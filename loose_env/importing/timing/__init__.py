"""Time bases: dates, clock alignment, resampling.

Data flow: dates -> resampling -> clock_alignment -> even_stamps.
"""
