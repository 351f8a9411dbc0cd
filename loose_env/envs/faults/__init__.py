"""Hidden faults: difficulty, seats and their sampling.

Data flow: difficulty -> seat_stops -> compound_seats -> sampler.
"""
