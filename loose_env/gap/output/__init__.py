"""Result schema, its calibration, checkpoints, and export of the corrected model.

Data flow: checkpoints -> evidence_schema -> result -> calibration -> export_mjcf -> export_check ->
targets.
"""
