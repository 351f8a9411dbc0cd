"""Result schema, checkpoints, and export of the corrected model.

Data flow: checkpoints -> evidence_schema -> result -> export_mjcf -> export_check ->
targets.
"""
