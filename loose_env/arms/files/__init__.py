"""Reading of arms from MJCF and URDF files.

Data flow: drive_limits -> safe_scan -> packages -> model_reader -> serial_chain -> chain_spec ->
report -> load.
"""
