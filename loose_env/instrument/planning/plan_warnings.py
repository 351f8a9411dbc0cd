"""Warnings of a plan: collisions, limits, sag of the servos, faults that stay undetectable."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from loose_env.diagnosis import propose_excitation
from loose_env.instrument.model.clearance import Ground
from loose_env.instrument.model.instrumented_arm import InstrumentedArm
from loose_env.instrument.planning.candidate_poses import pose_range
from loose_env.instrument.planning.expected_observations import Expected
from loose_env.instrument.planning.signals.signal import Signal
from loose_env.instrument.result import HEALTHY, Diagnosis, NextMeasurement
from loose_env.instrument.settings.measurement import NextSettings
from loose_env.instrument.settings.thresholds import (
    DETECTABLE_Z,
    NOTED_SAG_DEG,
    NOTED_SAG_M,
    SCALED_LEVEL,
)


def shown_position(slides: np.bool_, value: float) -> str:
    """A position of a joint with its unit."""
    return f"{value * 1e3:.4g} mm" if slides else f"{np.degrees(value):.4g} degrees"


def _sags(arm: InstrumentedArm, signal: Signal) -> list[str]:
    """Warnings about servos that sag under the weight of the arm."""
    sliding = arm.nominal.sliding
    noted = np.where(sliding, NOTED_SAG_M, np.radians(NOTED_SAG_DEG))
    far = [
        f"{arm.joints[j]} by {shown_position(sliding[j], abs(float(signal.sags[j])))}"
        for j in np.flatnonzero(np.abs(signal.sags) > noted)
    ]
    if not far:
        return []
    return [
        f"servos sag under the arm's weight: {', '.join(far)}. The signal begins with the "
        "pose as its command, makes up for that before the noise and goes back after it; a "
        "controller that holds joints exactly where it is told would move the arm by so much"
    ]


def plan_warnings(
    arm: InstrumentedArm,
    known: Diagnosis | None,
    chosen: NextMeasurement,
    signals: tuple[Signal, ...],
    choice: NextSettings,
    expected: Mapping[str, Expected],
) -> tuple[str, ...]:
    """Warnings of a plan, in sentences."""
    said: list[str] = []
    pose = np.array([chosen.pose[name] for name in arm.joints])
    if known is not None and known.settled:
        said.append(
            f"the diagnosis is settled: {known.fault.hypothesis} with {known.probability:.1%}; "
            "this measurement would only confirm it"
        )
    unseen = arm.collisions.unseen
    if unseen:
        said.append(
            f"the model has no shapes of {', '.join(unseen)}: what they touch is not known; look "
            "before the arm moves"
        )
    if not arm.collisions.known:
        said.append(
            "the model has no shapes that collide: nothing is known about collisions; look before "
            "the arm moves, and take another pose with --pose-deg if it would touch anything"
        )
    touching = arm.collisions.touch(pose)
    if touching:
        said.append(f"in this pose the model's bodies touch: {', '.join(touching)}")
    if not Ground.of(arm.nominal, choice.ground_m).clear(pose):
        said.append("in this pose a part of the arm is below its base or the ground given")
    low, high = pose_range(arm.nominal, 0.0)
    for j in np.flatnonzero((pose < low + 1e-3) | (pose > high - 1e-3)):
        said.append(f"joint {arm.joints[j]} is at the end of its range")
    if signals[0].kind == "model":
        said += _sags(arm, signals[0])
    for signal in signals:
        if signal.scale < SCALED_LEVEL:
            said.append(
                f"{signal.joint} is shaken at {signal.scale:.0%} of the level: {signal.limited_by}"
            )
    top = max(one.deviations for name, one in expected.items() if name != HEALTHY)
    if top < DETECTABLE_Z and any(signal.scale < SCALED_LEVEL for signal in signals):
        said.append(
            f"no fault is detectable in this run: at the level that is left the largest z-score is "
            f"{top:.1f}, and {DETECTABLE_Z:g} is needed. Take the limits of the machine's data "
            "sheet where they are higher, more --seconds, --commands torque or position where "
            "the controller takes them, or shake the tool: --excitation hammer"
        )
    said += [
        note
        for note in arm.with_joint_names(propose_excitation(arm.nominal, pose).warnings)
        if not note.startswith("the lowest holding mode")  # above its modes an arm is free
    ]
    if arm.hold != "model":
        said.append(
            f"joints are taken to be held by {arm.held_by}; 'loose diagnose' assumes what "
            "the model's actuators do, so put such springs into the model"
        )
    return tuple(dict.fromkeys((*said, *arm.notes)))
