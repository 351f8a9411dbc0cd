"""Export of servo friction as parameter files of BAM (Better Actuator Models, Rhoban).

A file of BAM has the keys ``model`` ("m1" to "m6") and ``actuator``, and parameters by name:
``bam.model.load_model`` of better-actuator-models 1.0 reads it. Its friction is ``friction_base`` +
``friction_stribeck`` exp(-(v/``dtheta_stribeck``)^``alpha``) + ``friction_viscous`` v, in model m5
also ``load_friction_motor`` times the motor's torque, with a Stribeck part of its own.
"""

from __future__ import annotations

from collections.abc import Sequence

from loose_env.errors import InvalidSetting
from loose_env.gap.output.result import NamedEffect
from loose_env.gap.output.targets.drives import JointValues, joint_values
from loose_env.gap.output.targets.source import (
    ALL,
    Export,
    ExportSource,
    effect_words,
    not_carried,
)
from loose_env.io import json_text

SERVOS = (
    "mx64", "mx106", "xl320", "xl330", "xl330i", "erob80_100", "erob80_50", "sts3215",
    "unitree_go1",
)  # fmt: skip
"""Actuators of better-actuator-models 1.0 (``bam.actuators``)."""
_CARRIED = {
    "viscous_friction": ALL,
    "coulomb_friction": ALL,
    "stribeck_friction": ALL,
    "rotor_inertia": ALL,
    "load_friction": ALL,
}
_ALPHA = 2.0
"""Exponent of the Stribeck curve in this package."""
_SPEED = 0.2
"""Stribeck speed of BAM where none is identified [rad/s]; without effect there."""


def bam_export(source: ExportSource, servo: str = "") -> Export:
    """Write a parameter file of BAM for each hinge with a named effect."""
    if servo not in SERVOS:
        raise InvalidSetting(
            f"BAM needs the servo of the joints: give --servo with one of {', '.join(SERVOS)}"
            + (f"; got {servo!r}" if servo else "")
        )
    effects = source.result.effects
    files, left = {}, list(not_carried(effects, _CARRIED))
    for joint in joint_values(source.model):
        own = [e for e in effects if e.where in _locations(joint) and e.kind in _CARRIED]
        if not own:
            continue
        if not joint.turns:
            left += [f"{effect_words(e)}; BAM has no slides" for e in own]
            continue
        files[f"bam_{_safe(joint.name)}.json"] = json_text(_parameters(joint, own, servo))
    if not files:
        raise InvalidSetting(
            "the result names no effect that BAM has: viscous, Coulomb, Stribeck or load-dependent "
            "friction or rotor inertia of a hinge; choose another target"
        )
    return Export(
        files=files,
        not_expressed=tuple(left),
        notes=(
            f"torque constant and resistance (kt, R) are those of {servo} in BAM; they are not "
            "identified",
            "BAM computes back-EMF itself (kt² v / R): where the nominal model has none, "
            "friction_viscous contains it and is too large by kt² / R",
        ),
    )


def _locations(joint: JointValues) -> tuple[str, ...]:
    return (joint.name,) if joint.drive is None else (joint.name, joint.drive.name)


def _safe(name: str) -> str:
    return "".join(c if c.isalnum() or c in "-_." else "_" for c in name)


def _parameters(
    joint: JointValues, effects: Sequence[NamedEffect], servo: str
) -> dict[str, float | str]:
    """Parameters of one joint in the order of BAM's own files.

    Friction that grows with the load is that of model m5.
    """
    stribeck = next((e for e in effects if e.kind == "stribeck_friction"), None)
    load = next((e for e in effects if e.kind == "load_friction"), None)
    fall, speed = 0.0, _SPEED
    if load is not None:
        speed = load.parameters.get("speed", _SPEED)
    if stribeck is not None:
        fall = (stribeck.parameters["static_ratio"] - 1.0) * stribeck.parameters["torque"]
        speed = stribeck.parameters["speed"]
    found: dict[str, float | str] = {"armature": joint.armature, "q_offset": 0.0}
    found["friction_base"] = max(joint.frictionloss - fall, 0.0)
    if stribeck is not None or load is not None:
        found |= {"friction_stribeck": fall, "dtheta_stribeck": speed, "alpha": _ALPHA}
    if load is not None:
        share = load.parameters["share"]
        found |= {
            "load_friction_motor": share,
            "load_friction_external": load.parameters.get("load_share", 0.0),
            "load_friction_motor_stribeck": share * (load.parameters.get("static_ratio", 1.0) - 1),
            "load_friction_external_stribeck": 0.0,
        }
    found["friction_viscous"] = joint.damping
    found["model"] = "m5" if load is not None else "m2" if stribeck is not None else "m1"
    found["actuator"] = servo
    return found
