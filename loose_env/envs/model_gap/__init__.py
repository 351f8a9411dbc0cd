"""The environment that chooses motions to find what a model lacks.

Data flow: hidden_machine -> settings -> observation -> env -> make.
"""
