"""Methods that only agents and studies under evaluation use.

Data flow: line_spectrum -> particles -> pose_sets -> sequential.
"""
