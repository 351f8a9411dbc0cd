"""Reports of a diagnosis and of a plan.

Data flow: arm_figure -> figures -> text -> notebook -> page ->
write -> plan_text -> plan_page.
"""
