"""Sections, their registry, runs, page and plots.

Data flow: looseness_joint_rig -> plots -> registry -> section -> run -> page -> signal_panels.
"""
