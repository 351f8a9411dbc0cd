"""Training from scratch on the environment's own observation and action.

Data flow: record_set -> learning_curve -> joint_inference -> training.
"""
