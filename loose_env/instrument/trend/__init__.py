"""Transmission of every run, and its change since earlier sessions.

Data flow: transmission -> cusum -> maintenance -> series -> trend -> earlier.
"""
