"""Report of a comparison of agents.

Data flow: confusion_matrix -> cost_figures -> episode_story -> page -> report ->
terminal_tables -> text.
"""
