"""Which effects look alike: what a winner has to be compared with before it is named."""

from __future__ import annotations

import mujoco

from loose_env.gap.effect import Effect

__all__ = ["akin", "joint_of"]

_ALIKE = (
    ("command_delay", "actuator_lag", "joint_compliance", "sensor_delay"),
    ("joint_compliance", "link_flexibility"),
    ("joint_compliance", "backlash", "structural_looseness"),
    ("coulomb_friction", "stribeck_friction", "backlash"),
    ("viscous_friction", "quadratic_drag", "actuator_gain", "actuator_lag"),
    ("payload", "link_mass", "link_com", "actuator_gain", "joint_spring", "rotor_inertia"),
    ("base_tilt", "sensor_bias", "encoder_offset"),
    ("sensor_gain", "actuator_gain", "sensor_misalignment"),
)
"""Kinds that a recording may fail to tell apart."""


def joint_of(effect: Effect) -> int | None:
    """Number of the joint that an effect's place belongs to; None: to the whole arm.

    Parts of one name, such as a joint and its motor, are told apart by what the effect acts on.
    """
    machine, where, part = effect.machine, effect.where, effect.part
    if part == "joint" and where in machine.joints:
        return machine.joint_number(where)
    if part == "actuator" and where in machine.actuated_joint:
        return machine.joint_number(machine.actuated_joint[where])
    if part == "link" and where in machine.links:
        return machine.joint_number(machine.first_joint(where))
    if part == "sensor" and where in machine.sensors:
        sensor = machine.model.sensor(where)
        if int(sensor.objtype[0]) == mujoco.mjtObj.mjOBJ_JOINT:
            return int(sensor.objid[0])
    return None


def akin(effect: Effect, other: Effect) -> bool:
    """Whether two effects may look alike: kinds that do, at the same joint or the next.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> from loose_env.gap.catalogue import CATALOGUE
    >>> from loose_env.gap.machine import Machine
    >>> machine = Machine(planar(3).spec)
    >>> second = machine.joints[1]
    >>> spring = CATALOGUE["joint_spring"](machine, second)
    >>> akin(spring, CATALOGUE["link_mass"](machine, machine.body_of(second)))
    True
    >>> akin(spring, CATALOGUE["viscous_friction"](machine, second))
    False
    """
    if not any(effect.kind in group and other.kind in group for group in _ALIKE):
        return False
    first, second = joint_of(effect), joint_of(other)
    return first is None or second is None or abs(first - second) <= 1
