"""Files of a plan: signals, trajectory messages, the plan itself, its settings.

Data flow: ros_trajectory -> signal_files -> planned_runs -> plan_files -> session_settings.
"""
