"""Models of a loose joint and their identification.

Data flow: docked_simulation -> inertia_condition -> looseness_joint -> modelling_alternatives
-> parameter_recursion -> static_force_test.
"""
