"""Report of a comparison of agents.

Data flow: confusion_matrix -> cost_figures -> episode_timeline -> page -> report ->
terminal_tables -> text.
"""
