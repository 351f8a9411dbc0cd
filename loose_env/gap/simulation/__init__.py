"""Forward simulation and inverse dynamics of a hypothesis.

Data flow: time_step -> driven_effects -> torque_terms -> sensor_timing -> simulator ->
unmeasured_dofs -> compared_torques -> inverse_dynamics.
"""
