"""Settings of the instrument, with units and validation.

Data flow: thresholds -> command_line -> validation -> arm_and_plan -> motion -> measurement
-> tolerances -> diagnosis -> trend.
"""
