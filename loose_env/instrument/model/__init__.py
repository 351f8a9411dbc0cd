"""The arm's model as recordings and plans need it: actuators, tool site, clearance.

Data flow: actuators -> clearance -> tool_site -> recorded_arm -> recording_model -> planned_arm
-> holding_commands.
"""
