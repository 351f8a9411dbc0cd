"""Chapter 4: diagnosis of the loose link.

Data flow: comparative_index -> index_tables -> link_finding -> pose_figures -> pose_trials ->
pose_choice -> vera_link_finding.
"""
