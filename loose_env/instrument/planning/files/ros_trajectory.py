"""Signals as ROS 2 messages: ``trajectory_msgs/msg/JointTrajectory`` in YAML.

One message for a whole signal. Every point has ``positions`` [rad, m], ``velocities`` [rad/s,
m/s] and ``time_from_start``; ``effort`` [N·m, N] for torques, whose positions are the pose.
``accelerations`` are empty.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from loose_env.errors import InvalidSetting
from loose_env.instrument.model.instrumented_arm import InstrumentedArm
from loose_env.typing import Array

_DIGITS = 9
"""Significant digits of a value."""


def joint_columns(arm: InstrumentedArm, played: Mapping[str, Array]) -> tuple[str, Array]:
    """Kind and values by joint (T, n) of a signal's columns.

    Commands of the model's actuators become positions where all of them are servos, and torques
    where all are motors.
    """
    kind = next(iter(played)).partition(".")[0]
    if kind != "ctrl":
        return kind, np.array([played[f"{kind}.{name}"] for name in arm.joints]).T
    drives = [drive for drive in arm.drives if drive is not None]
    servos = [drive.servo for drive in drives]
    if len(drives) < arm.n or len(set(servos)) > 1:
        raise InvalidSetting(
            "a JointTrajectory has one kind of command for all joints, and the model's actuators "
            "are of several: give --commands position, velocity or torque"
        )
    if servos[0]:
        values = [(played[f"ctrl.{d.actuator}"] * d.gain + d.offset) / d.stiffness for d in drives]
        return "position", np.array(values).T
    values = [played[f"ctrl.{d.actuator}"] * d.gain + d.offset for d in drives]
    return "torque", np.array(values).T


def trajectory_text(
    joints: tuple[str, ...], kind: str, time: Array, values: Array, pose: Array
) -> str:
    """YAML of a message.

    Examples
    --------
    >>> time = np.array([0.0, 0.5])
    >>> text = trajectory_text(("a",), "torque", time, np.array([[0.0], [2.0]]), np.array([1.5]))
    >>> print(text.splitlines()[-1])
    - {positions: [1.5], velocities: [0], accelerations: [], effort: [2], time_from_start: {sec: ...
    """
    step = float(time[1] - time[0]) if len(time) > 1 else 0.0
    positions = np.broadcast_to(pose, values.shape)
    velocities, effort = np.zeros_like(values), None
    if kind == "position":
        positions = values
        velocities[1:-1] = (values[2:] - values[:-2]) / (2 * step) if step else 0.0
    elif kind == "velocity":  # each is held for a sample
        positions = pose + step * np.concatenate([values[:1] * 0, np.cumsum(values[:-1], axis=0)])
        velocities = values
    else:
        effort = values
    names = ", ".join('"' + name.replace("\\", "\\\\").replace('"', '\\"') + '"' for name in joints)
    lines = [
        'header: {stamp: {sec: 0, nanosec: 0}, frame_id: ""}',
        f"joint_names: [{names}]",
        "points:",
    ]
    for k, at in enumerate(time):
        sec, nanosec = divmod(round((float(at - time[0]) + step) * 1e9), 10**9)
        lines.append(
            f"- {{positions: [{_row(positions[k])}], velocities: [{_row(velocities[k])}], "
            f"accelerations: [], effort: [{'' if effort is None else _row(effort[k])}], "
            f"time_from_start: {{sec: {sec}, nanosec: {nanosec}}}}}"
        )
    return "\n".join(lines) + "\n"


def _row(values: Array) -> str:
    # An exponent needs a point in YAML 1.1: 1e-07 would be read as text.
    return ", ".join(_yaml_number(float(v)) for v in values)


def _yaml_number(value: float) -> str:
    text = f"{value:.{_DIGITS}g}"
    mantissa, mark, exponent = text.partition("e")
    return f"{mantissa}.0e{exponent}" if mark and "." not in mantissa else text
