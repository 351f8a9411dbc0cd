"""Reports of a plan.

Data flow: plan_motion -> plan_text -> plan_page -> tool_plan_page.
"""
