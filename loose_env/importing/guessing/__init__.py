"""Proposal of a mapping by names, units and signals.

Data flow: channel_names -> quantities -> joint_targets -> signals -> units_by_range -> roles ->
commands -> source_signals -> proposal -> proposal_text.
"""
