"""Loose seats and play in motor torque and encoder alone, without accelerometer (2.2.2, 4.22-4.26).

Each joint is excited in turn on an arm with a fault and on its healthy twin. From either record
come three joint-side indices: apparent inertia against the nominal arm, incoherence of joint
acceleration and torque, and excess kurtosis of the joint acceleration; and, for comparison, the
change of the tool's transmission against the nominal arm. An index of an arm is its largest over
the joints. The area under the ROC curve (AUC) is the probability that a loose arm shows more of an
index than a healthy one: 0.5 is chance.

Usage: python scripts/thesis/joint_side.py --arms 128 --level 3
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import mannwhitneyu

from loose_env.arms import Arm, planar, vera
from loose_env.cli.command import command
from loose_env.diagnosis import SensorFloor, predict, statistics_of
from loose_env.io import Count
from loose_env.rig import Measurement
from loose_env.sensors import SensorSuite
from loose_env.statistics import acceleration_from_angle, shape_of
from loose_env.typing import Array
from scripts.thesis.estimators import transfer_function
from scripts.thesis.twins import Twins

INDICES = ("apparent inertia", "incoherence", "kurtosis of the joint", "tool, transmission")
DRAWS = 1000
"""Resamples of arms for the 95 % intervals."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of the study."""

    arms: Count = 128
    """Arms of each kind of fault, with as many healthy twins."""
    level: Count = 3
    """Excitation level, from 1."""
    seed: int = 0
    """Root of all draws."""


def indices_of(record: Measurement, twins: Twins, joint: int) -> list[float]:
    """Indices of a record with one joint (from 0) excited, in the order of `INDICES` [1]."""
    found, (low, high) = statistics_of(record), record.excitation.band
    floor = SensorFloor.of(SensorSuite(), twins.linear.arm.band)
    nominal = predict(twins.linear.at(record.pose), record.excitation, floor)
    motion = acceleration_from_angle(record.encoder[joint], record.rate, (low, high))
    answer = transfer_function(record.command[joint], motion, record.rate, segments=8)
    inside = (answer.frequencies >= low) & (answer.frequencies <= high)
    expected = nominal.transmission_by_instrument[:, 0]
    change = found.transmission_by_instrument[:, joint] - expected
    return [
        abs(float(found.inertia[joint] / nominal.inertia[0]) - 1.0),
        1.0 - float(np.mean(answer.coherence[..., inside])),
        float(shape_of(motion)[1]),
        float(np.linalg.norm(change) / np.linalg.norm(expected)),
    ]


def study(arm: Arm, place: str, settings: Settings) -> Array:
    """Largest indices over the joints, of loose arms and of their twins (2, arms, indices)."""
    twins = Twins.draw(arm, settings.arms, [settings.seed, 61], place=place)
    found = np.full((arm.n, 2, settings.arms, len(INDICES)), np.nan)
    for joint in range(arm.n):
        shakes = twins.one_joint(joint, arm.levels[settings.level - 1])
        for k, pair in enumerate(twins.measure(shakes, [settings.seed, 62, joint])):
            if pair is not None:
                found[joint, :, k] = [indices_of(record, twins, joint) for record in pair]
    return np.asarray(np.nanmax(found, axis=0))


def auc(both: Array) -> float:
    """Probability that a loose arm's index exceeds a healthy one's (2, arms), ties as half."""
    return float(mannwhitneyu(*both).statistic / both.shape[1] ** 2)


def compare(settings: Settings) -> None:
    """Run the study and print a row for each arm and kind of fault."""
    print(f"AUC (95 % interval), {settings.arms} arms a row, level {settings.level}")
    print("{:10s} {:22s}".format("arm", "fault") + "".join(f"{i:>26s}" for i in INDICES))
    rng = np.random.default_rng([settings.seed, 63])
    for arm in (planar(4), vera()):
        for place in ("structural_looseness@link", "backlash@joint"):
            cells = []
            for both in np.moveaxis(study(arm, place, settings), 2, 0):
                draws = rng.integers(settings.arms, size=(DRAWS, settings.arms))
                low, high = np.quantile([auc(both[:, d]) for d in draws], [0.025, 0.975])
                cells.append(f"{auc(both):.2f} ({low:.2f} to {high:.2f})")
            row = "".join(f"{cell:>26s}" for cell in cells)
            print(f"{arm.name:10s} {place.partition('@')[0]:22s}{row}")


def main(arguments: Sequence[str] | None = None) -> None:
    """Compare, with errors in one line."""
    command("joint_side", __doc__, Settings, compare, arguments)


if __name__ == "__main__":
    main()
