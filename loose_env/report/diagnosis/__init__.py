"""Reports of a diagnosis and of a trend.

Data flow: arm_figure -> figures -> text -> spectra -> hypotheses -> notebook -> page
-> trend_figure -> trend_page -> write.
"""
