"""Reports of a diagnosis and of a plan.

Data flow: arm_figure -> figures -> text -> spectra -> hypotheses -> page -> plan_text -> plan_page.
"""
