"""The catalogue of effects a model can lack, one file a family.

Data flow: mjcf -> drives -> drivetrain -> friction -> joint_elasticity -> backlash ->
link_inertia -> link_flexibility -> sensors -> structural_looseness -> catalogue.
"""
