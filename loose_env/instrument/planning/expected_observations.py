"""Expected observation of a record under each fault hypothesis, before it is taken."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from loose_env.arms import Arm, LinearArm
from loose_env.diagnosis import ToolFrames
from loose_env.instrument.model.instrumented_arm import InstrumentedArm
from loose_env.instrument.planning.excitation import sensitivity
from loose_env.instrument.planning.next_measurement import seat_features
from loose_env.instrument.planning.prior_knowledge import Known
from loose_env.instrument.planning.rationale import expected_directions
from loose_env.instrument.result import NextMeasurement
from loose_env.instrument.settings.measurement import NextSettings
from loose_env.typing import Array


@dataclass(frozen=True, kw_only=True)
class Expected:
    """Expected observation of the first record under one hypothesis."""

    probability: float
    """Before it [1]."""
    direction_tool: tuple[float, ...] | None
    """Direction along which transmission is lost, tool frame, axial; None where any is possible."""
    lost: float
    """Share of the transmission along it that is expected to be lost, at the gap of interest
    [1]."""
    deviations: float
    """Change of the tool's motion that this makes, over what sensors and model leave open [1]."""


def expected_of(
    arm: InstrumentedArm,
    linear: LinearArm,
    known: Known | None,
    chosen: NextMeasurement,
    choice: NextSettings,
) -> dict[str, Expected]:
    """Expected observation of the first record under each hypothesis."""
    nominal = arm.nominal
    names = arm.hypotheses
    so_far = Known() if known is None else known
    pose = np.array([chosen.pose[name] for name in arm.joints])
    banded = replace(nominal, band=chosen.band_hz)
    features = seat_features(linear.variant(banded), choice)
    torque = np.zeros(nominal.n)
    torque[arm.joints.index(chosen.joints[0])] = chosen.torques[0]
    found = sensitivity(features, pose, torque, chosen.seconds)
    reach = max(nominal.reach, 1e-6)
    gap = choice.gap_mm * 1e-3
    # Play of a joint: the turn that moves the tool as far as the gap at full reach.
    hinge = np.where(nominal.sliding, gap, gap / reach)
    slides = len(found.opens) - nominal.n
    lost = found.lost(np.concatenate([np.full(slides, gap), hinge]))
    seen = lost * found.by_model
    directions = expected_directions(nominal, so_far, pose, arm.links, arm.joints)
    images = features.directions
    shown: dict[str, Expected] = {}
    even = {names[0]: 1 / 3} | dict.fromkeys(names[1:], 1 / (3 * nominal.n))
    for k, name in enumerate(names):
        direction = directions[name]
        if k == 0:
            share, size = 0.0, 0.0
        elif k <= nominal.n:
            rows = slice((k - 1) * len(images), k * len(images))
            near = np.ones(len(images))
            if direction is not None:
                near = _near(nominal, pose, k - 1, images, direction)
            share = float(near @ lost[rows] / near.sum())
            size = float(near @ seen[rows] / near.sum())
        else:
            location = slides + k - 1 - nominal.n
            share, size = float(lost[location]), float(seen[location])
        shown[name] = Expected(
            probability=float((so_far.probabilities or even)[name]),
            direction_tool=None if direction is None else tuple(float(x) for x in direction),
            lost=share,
            deviations=size,
        )
    return shown


def _near(nominal: Arm, pose: Array, link: int, grid: Array, direction: Array) -> Array:
    """Weight of each direction of a link's grid: near the one that is expected."""
    image = ToolFrames(nominal).images(pose)[0, link]
    own = image.T @ direction
    return np.asarray(np.exp(-0.5 * ((1 - np.abs(grid @ own)) / 0.02) ** 2) + 1e-12)
