"""Expected information of a record, and bounds on what a record can tell.

Data flow: information_gain -> record_bound.
"""
