"""Column names of Universal Robots' RTDE logs: vector fields expanded, recipe by width.

A recipe names fields; a field that is a vector becomes one column for each entry, ``actual_q_0``
to ``actual_q_5``, as the recorder of Universal Robots' own Python library writes them.
"""

from __future__ import annotations

from collections.abc import Sequence

_SIX = """
target_q target_qd target_qdd target_current target_moment actual_q actual_qd actual_qdd
actual_current actual_current_window actual_current_as_torque joint_control_output
joint_temperatures joint_mode actual_joint_voltage actual_TCP_pose actual_TCP_speed
actual_TCP_force target_TCP_pose target_TCP_speed ft_raw_wrench payload_inertia
"""
_THREE = "actual_tool_accelerometer payload_cog elbow_position elbow_velocity"
_WIDTHS = dict.fromkeys(_SIX.split(), 6) | dict.fromkeys(_THREE.split(), 3)
_RECORD = """
timestamp target_q target_qd target_qdd target_current target_moment actual_q actual_qd
actual_current joint_control_output actual_TCP_pose actual_TCP_speed actual_TCP_force
target_TCP_pose target_TCP_speed actual_digital_input_bits joint_temperatures
actual_execution_time robot_mode joint_mode safety_mode actual_tool_accelerometer speed_scaling
target_speed_fraction actual_momentum actual_main_voltage actual_robot_voltage
actual_robot_current actual_joint_voltage actual_digital_output_bits runtime_state
"""

RECORD_RECIPE = tuple(_RECORD.split())
"""Fields of the recorder's own ``record_configuration.xml``."""


def expanded_names(names: Sequence[str]) -> list[str]:
    """Names of columns: a vector field of RTDE becomes its entries, others stay as they are.

    Examples
    --------
    >>> expanded_names(["timestamp", "actual_tool_accelerometer"])
    ['timestamp', 'actual_tool_accelerometer_0', 'actual_tool_accelerometer_1',
    'actual_tool_accelerometer_2']
    """
    found = []
    for name in names:
        width = _WIDTHS.get(name, 1)
        found += [f"{name}_{i}" for i in range(width)] if width > 1 else [name]
    return found


def recipe_of_width(columns: int) -> tuple[str, ...]:
    """Fields of the recorder's own recipe if a nameless table has as many columns, else none."""
    return RECORD_RECIPE if columns == len(expanded_names(RECORD_RECIPE)) else ()
