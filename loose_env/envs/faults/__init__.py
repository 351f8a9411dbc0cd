"""Hidden faults: difficulty, seats and their sampling.

Data flow: difficulty -> seats -> sampler.
"""
