"""Page template, style, figure cards and tables shared by all reports.

Data flow: figure_card -> palette -> figures -> legend -> style -> svg -> table -> template
-> sections -> notebook.
"""
