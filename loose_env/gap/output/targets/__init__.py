"""Exports of identified effects to other simulators, identification tools and trainers.

Data flow: source -> model_parameters -> drives -> sysid_parameters -> actuator_configs ->
urdf_tags -> bam_files -> ranges -> export.
"""
