"""Joint at which an effect acts, and tests for effects that are confusable or at one joint."""

from __future__ import annotations

import mujoco

from loose_env.gap.model.effect import Effect

_CONFUSABLE_KINDS = (
    ("command_delay", "actuator_lag", "joint_compliance", "sensor_delay"),
    ("joint_compliance", "link_flexibility", "base_compliance"),
    ("joint_compliance", "backlash", "structural_looseness"),
    ("coulomb_friction", "stribeck_friction", "load_friction", "backlash"),
    ("viscous_friction", "coulomb_friction", "load_friction", "actuator_gain"),
    ("coulomb_friction", "load_friction", "asymmetric_friction", "joint_spring"),
    ("dead_zone", "backlash", "coulomb_friction", "actuator_gain"),
    ("torque_limit", "voltage_limit", "actuator_gain", "actuator_lag", "viscous_friction"),
    ("torque_constant", "actuator_gain"),
    ("gear_eccentricity", "encoder_offset", "sensor_gain", "joint_spring"),
    ("viscous_friction", "quadratic_drag", "actuator_gain", "actuator_lag"),
    ("payload", "link_mass", "link_com", "actuator_gain", "joint_spring", "rotor_inertia"),
    ("payload", "link_mass", "link_com", "gravity_compensation", "joint_spring", "base_tilt"),
    ("base_tilt", "sensor_bias", "encoder_offset"),
    ("sensor_gain", "actuator_gain", "sensor_misalignment"),
)
"""Kinds that a recording may fail to tell apart."""


def joint_of(effect: Effect) -> int | None:
    """Index of the joint of an effect's location; None for the whole arm.

    Parts of one name, such as a joint and its motor, are distinguished by the element the effect
    acts on.
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


def confusable(effect: Effect, other: Effect) -> bool:
    """Return whether two effects are confusable: by kind, at the same or next joint.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> from loose_env.gap.model.effects.catalogue import CATALOGUE
    >>> from loose_env.gap.model.nominal_model import NominalModel
    >>> machine = NominalModel(planar(3).spec)
    >>> second = machine.joints[1]
    >>> spring = CATALOGUE["joint_spring"](machine, second)
    >>> confusable(spring, CATALOGUE["link_mass"](machine, machine.body_of(second)))
    True
    >>> confusable(spring, CATALOGUE["viscous_friction"](machine, second))
    False
    """
    if not any(effect.kind in group and other.kind in group for group in _CONFUSABLE_KINDS):
        return False
    first, second = joint_of(effect), joint_of(other)
    return first is None or second is None or abs(first - second) <= 1


def near(one: Effect, other: Effect) -> bool:
    """Return whether two effects are at one joint, or confusable."""
    return joint_of(one) == joint_of(other) is not None or confusable(one, other)
