"""The arm's model as recordings and plans need it: actuators, sensors, tool site, clearance.

Data flow: actuators -> clearance -> tool_site -> recording_model -> readings -> instrumented_arm
-> holding_commands -> motion_limits.
"""
