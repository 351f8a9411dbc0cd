"""Groups of effects fitted jointly, and pairs of confusable effects.

A group is one kind at several locations, since servos, gears and bearings of an arm are alike; or
all friction at one joint, since oil, seals and air act together.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import mujoco

from loose_env.gap.model.effect import Effect
from loose_env.gap.selection.screening.screening import Screened

__all__ = ["confusable", "families", "frictions", "joint_of", "pairs"]

_ALL = "all"
_LEAST = 0.02
"""Promise of a member, as a share of the most promising one of its family."""
_PAIRED = 5
"""Kinds of a joint of which pairs are made, the most promising ones."""
_FRICTIONS = ("viscous_friction", "coulomb_friction", "quadratic_drag")
"""What grows with no power of the speed, the first and the second. One of them, fitted to all
three, leaves a little that neither of the others is any good for alone."""


def families(screened: Sequence[Screened], most: int) -> list[list[Screened]]:
    """Group candidates of one kind and variant at two or more locations.

    A drive with settings other than its model is seldom the only one. Fitted one at a time, each
    explains little as long as the others are missing, and another effect that explains a little of
    all of them would rank first. A candidate at "all" locations is such a group already, and no
    member.

    Parameters
    ----------
    screened : sequence of Screened
        Candidates, the most promising first.
    most : int
        Maximum number of groups.

    Returns
    -------
    list of list of Screened
        Groups with the highest total predicted explained variance, the best variant of every kind.
    """
    groups: dict[tuple[str, str], list[Screened]] = {}
    for each in screened:
        if each.effect.where == _ALL:
            continue
        groups.setdefault((each.effect.kind, each.effect.variant), []).append(each)
    best: dict[str, tuple[float, list[Screened]]] = {}
    for (kind, _), group in groups.items():
        least = _LEAST * group[0].predicted
        members = [each for each in group if each.predicted >= least]
        promise = sum(each.predicted for each in members)
        if len(members) > 1 and promise > best.get(kind, (0.0, []))[0]:
            best[kind] = promise, members
    ranked = sorted(best.values(), key=lambda found: -found[0])
    return [members for _, members in ranked[:most]]


def frictions(screened: Sequence[Screened], named: Sequence[Effect]) -> list[list[Screened]]:
    """Group the missing frictions at joints where one friction was identified.

    Parameters
    ----------
    screened : sequence of Screened
        Candidates.
    named : sequence of Effect
        The identified effects.

    Returns
    -------
    list of list of Screened
        One group of two for each such joint, where both are candidates.
    """
    joints = dict.fromkeys(effect.where for effect in named if effect.kind in _FRICTIONS)
    groups = [
        [s for s in screened if s.effect.where == joint and s.effect.kind in _FRICTIONS]
        for joint in joints
    ]
    return [group for group in groups if len(group) > 1]


def pairs(screened: Sequence[Screened], most: int) -> list[list[Screened]]:
    """Group candidates of two kinds at one joint, which may explain only together.

    Friction behind play, a gain beside a load friction: alone, either leaves the residual as large
    as it was, or makes it larger.

    Parameters
    ----------
    screened : sequence of Screened
        Candidates, the most promising first.
    most : int
        Maximum number of groups.

    Returns
    -------
    list of list of Screened
        Pairs with the highest total predicted explained variance.
    """
    at: dict[int, list[Screened]] = {}
    for each in screened:
        joint = joint_of(each.effect)
        kinds = {other.effect.kind for other in at.get(joint, [])} if joint is not None else set()
        if joint is not None and each.effect.kind not in kinds and len(kinds) < _PAIRED:
            at.setdefault(joint, []).append(each)
    found = [list(pair) for there in at.values() for pair in combinations(there, 2)]
    found.sort(key=lambda pair: -sum(each.predicted for each in pair))
    return found[:most]


_ALIKE = (
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
    if not any(effect.kind in group and other.kind in group for group in _ALIKE):
        return False
    first, second = joint_of(effect), joint_of(other)
    return first is None or second is None or abs(first - second) <= 1
