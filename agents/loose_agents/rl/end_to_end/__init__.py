"""Training from scratch on the environment's own observation and action.

Data flow: record_set -> learning_curve -> evaluation -> joint_inference -> device_buffer ->
rollout_worker -> parallel_env -> training.
"""
