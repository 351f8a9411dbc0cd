"""Models of a loose joint and their identification.

Data flow: looseness_joint -> static_force_test -> docked_arm -> modelling_alternatives
-> parameter_recursion.
"""
