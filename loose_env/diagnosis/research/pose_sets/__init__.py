"""Choice of pose sets, and the limits of what they separate.

Data flow: limits -> pose_sets.
"""
