"""Reinforcement learning: networks, training, checkpoints, hyperparameters.

Data flow: checkpoint -> hyperparameters -> network -> learned_policy -> set_network ->
model_agent -> training_env -> training_options -> training_run -> end_to_end ->
motion_policy.
"""
