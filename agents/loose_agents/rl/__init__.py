"""Reinforcement learning: networks, training, checkpoints, hyperparameters.

Data flow: checkpoint -> hyperparameters -> network -> learned_policy -> training_env ->
training_options -> training_run.
"""
