"""Reinforcement learning: networks, training, checkpoints, hyperparameters.

Data flow: checkpoint -> hyperparameters -> network -> learned_policy -> model_agent ->
training_env -> training_options -> training_run -> end_to_end.
"""
