"""The next measurement: pose, excitation, expected observations, files.

Data flow: candidate_poses -> excitation -> prior_knowledge -> rationale -> next_measurement ->
detectability -> expected_observations -> signals -> plan_warnings -> plan
-> files.
"""
