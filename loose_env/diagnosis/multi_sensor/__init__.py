"""Evidence from several accelerometers along the arm.

Data flow: direction_search -> incoherent_motion -> sensed_arm -> sensor_rows -> sensor_errors
-> link_evidence.
"""
