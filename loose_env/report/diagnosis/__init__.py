"""Reports of a diagnosis, of a plan and of a trend.

Data flow: arm_figure -> figures -> text -> spectra -> hypotheses -> page -> plan_text
-> plan_page -> trend_figure -> trend_page -> write.
"""
