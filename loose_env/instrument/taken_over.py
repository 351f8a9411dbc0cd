"""Whether a plan does what a diagnosis asks for next, or chooses for itself.

A diagnosis chooses with settings of its own, and with the model of the recording, which has no
meshes. What it asks for is taken over where the plan's settings are the same and the arm's own
model lets the arm get there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from math import isclose
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loose_env.errors import InvalidData
from loose_env.instrument.ground import Ground
from loose_env.instrument.model_arm import ModelArm
from loose_env.instrument.next_settings import NextSettings
from loose_env.instrument.result import NextMeasurement

__all__ = ["other_settings", "why_not_reached"]

Array = NDArray[np.float64]


def other_settings(chosen: NextMeasurement, choice: NextSettings) -> list[str]:
    """Names of the settings of a plan with which a measurement was not chosen.

    A measurement that does not say with which it was chosen, of an earlier version, is asked for
    its length, its rate and its ground alone.
    """
    before: Mapping[str, Any] = {
        "seconds": chosen.seconds,
        "rate_hz": chosen.rate_hz,
        "ground_m": None,
        **chosen.settings,
    }
    return [
        name
        for name, value in asdict(choice).items()
        if name in before and not _same(before[name], value)
    ]


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, int | float) and isinstance(other, int | float):
        return isclose(one, other, rel_tol=1e-6)  # files have seven digits
    return bool(one == other)


def why_not_reached(
    machine: ModelArm, ground: Ground, here: Array | None, chosen: NextMeasurement
) -> str:
    """Say what is in the way of a measurement, by the arm's own model; "" if nothing is.

    Parameters
    ----------
    machine : ModelArm
        The arm, with its shapes.
    ground : Ground
        What it stays above.
    here : ndarray (n,) or None
        Where it stands [rad or m]; None where that is not known.
    chosen : NextMeasurement
        The measurement.

    Raises
    ------
    InvalidData
        If the measurement is of another model.
    """
    pose = _pose_in(machine, chosen)
    touching = machine.collisions.touch(pose)
    if touching:
        return f"in it the model's bodies touch: {', '.join(touching)}"
    if not ground.clear(pose):
        return "a part of the arm is below its base or the ground given"
    if here is None:
        return ""
    touching = machine.collisions.touch_between(here, pose)
    if touching:
        return f"on the way there the model's bodies touch: {', '.join(touching)}"
    if not ground.clear_between(here, pose):
        return "on the way there a part of the arm is below its base or the ground given"
    return ""


def _pose_in(machine: ModelArm, chosen: NextMeasurement) -> Array:
    """The pose (n,) [rad or m], if the measurement fits the model."""
    lacking = [name for name in machine.joints if name not in chosen.pose]
    foreign = [name for name in (*chosen.joints, *chosen.pose) if name not in machine.joints]
    if lacking or foreign:
        raise InvalidData(
            f"the next measurement of the diagnosis is of another model: it has the joints "
            f"{', '.join(chosen.pose)}, the model {', '.join(machine.joints)}"
        )
    pose = np.array([chosen.pose[name] for name in machine.joints])
    if not machine.arm.within_ranges(pose).all():
        raise InvalidData(
            f"the pose of the diagnosis, {dict(chosen.pose)}, is outside the ranges of the model's "
            f"joints: {machine.arm.joint_ranges}"
        )
    return pose
