"""The environment that chooses motions to find what a model lacks.

Data flow: settings -> observation -> env -> make.
"""
