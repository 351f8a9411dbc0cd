"""Signals of a plan: commands within the limits of the controller, and the way to the pose.

Data flow: linear_answer -> motion_peaks -> played_commands -> signal -> band_choice
-> transit -> tool_plan.
"""
