"""Reports of a diagnosis and of a plan.

Data flow: arm_figure -> figures -> text -> page -> plan_motion -> plan_text -> plan_page
-> tool_plan_page.
"""
