"""Files of a plan: signals, trajectory messages, the plan itself, its settings.

Data flow: ros_trajectory -> signal_files -> planned_runs -> plan_folder -> plan_files
-> tool_plan_files -> session_settings.
"""
