"""Loose seats and play in motor torque and encoder alone, without accelerometer.

The thesis names current and back EMF as signals that a robot has anyway (2.2.2, 4.22 to 4.26). Here
the torque of a drive is known and its joint's encoder is read. Each joint is excited in turn on an
arm with a fault and on its healthy twin, with mismatch and default sensors. From either record come
three joint-side indices: apparent inertia against the nominal arm, incoherence of joint
acceleration and torque, and excess kurtosis of the joint acceleration; and, for comparison, the
change of the tool's transmission against the nominal arm. An index of an arm is its largest over
the joints. The area under the ROC curve (AUC) is the probability that a loose arm shows more of an
index than a healthy one: 0.5 is chance.

Usage: python scripts/studies/thesis/joint_side.py [--arms 128] [--level 3] [--seed 0]
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from loose_agents.jobs import ProgressLine
from scipy.stats import rankdata

from loose_env.arms import Arm, LinearArm, planar, vera
from loose_env.cli.command import command
from loose_env.diagnosis import SensorFloor, predict, statistics_of
from loose_env.envs import Difficulty, FaultSampler
from loose_env.excitation import at_levels
from loose_env.faults import Healthy
from loose_env.io import Count
from loose_env.rig import Job, Measurement, SimulatedRig
from loose_env.sensors import SensorSuite
from loose_env.statistics import acceleration_from_angle, kurtosis, transfer_function
from loose_env.typing import Array

INDICES = ("apparent inertia", "incoherence", "kurtosis of the joint", "tool, transmission")
DURATION = 1.2
"""Length of a record [s], as in the thesis."""
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


def indices_of(record: Measurement, linear: LinearArm, joint: int) -> list[float]:
    """Indices of a record with one joint (from 0) excited, in the order of `INDICES` [1]."""
    found = statistics_of(record)
    floor = SensorFloor.of(SensorSuite(), linear.arm.band)
    nominal = predict(linear.at(record.pose), record.excitation, floor)
    rate, (low, high) = record.rate, record.excitation.band
    motion = acceleration_from_angle(record.encoder[joint], rate, (low, high))
    answer = transfer_function(record.command[joint], motion, rate, segments=8)
    inside = (answer.frequencies >= low) & (answer.frequencies <= high)
    expected = nominal.transmission_by_instrument[:, 0]
    change = found.transmission_by_instrument[:, joint] - expected
    return [
        abs(float(found.inertia[joint] / nominal.inertia[0]) - 1.0),
        1.0 - float(np.mean(answer.coherence[..., inside])),
        float(kurtosis(motion[None])[0]),
        float(np.linalg.norm(change) / np.linalg.norm(expected)),
    ]


def study(arm: Arm, kind: str, settings: Settings) -> tuple[Array, Array]:
    """Largest indices over the joints, of loose arms and of their healthy twins (arms, indices)."""
    linear, difficulty = LinearArm(arm), Difficulty()
    sampler = FaultSampler(linear, difficulty)
    rig = SimulatedRig(arm, slots=2 * settings.arms)
    poses = []
    for k in range(settings.arms):
        rng = np.random.default_rng([settings.seed, 61, k])
        fault = sampler.draw(rng, hypothesis=f"{kind}{1 + k % arm.n}")
        mismatch = difficulty.mismatch.draw(arm, rng)
        rig.mount(2 * k, fault, mismatch)
        rig.mount(2 * k + 1, Healthy(), mismatch)
        poses.append(arm.random_pose(rng))
    found = np.full((arm.n, 2 * settings.arms, len(INDICES)), np.nan)
    with ProgressLine(arm.n, unit="joints excited") as line:
        for joint in range(arm.n):
            levels = np.where(np.arange(arm.n) == joint, arm.levels[settings.level - 1], 0.0)
            jobs = []
            for k, pose in enumerate(poses):
                shake, _ = at_levels(linear.at(pose), levels, duration=DURATION)
                for twin in (0, 1):
                    rng = np.random.default_rng([settings.seed, 62, k, joint, twin])
                    jobs.append(Job(slot=2 * k + twin, pose=pose, excitation=shake, rng=rng))
            for slot, record in enumerate(rig.measure_many(jobs)):
                if record.failure is None:
                    found[joint, slot] = indices_of(record, linear, joint)
            line.advance(1)
    largest = np.nanmax(found, axis=0)
    return largest[0::2], largest[1::2]


def auc(loose: Array, healthy: Array) -> float:
    """Probability that a loose arm's index exceeds a healthy one's, ties as half."""
    ranks = rankdata(np.concatenate([loose, healthy]))
    n, m = len(loose), len(healthy)
    return float((ranks[:n].sum() - n * (n + 1) / 2) / (n * m))


def compare(settings: Settings) -> None:
    """Run the study and print a row for each arm and kind of fault."""
    print(f"AUC (95 % interval), {settings.arms} arms a row, level {settings.level}")
    print("{:10s} {:22s}".format("arm", "fault") + "".join(f"{i:>26s}" for i in INDICES))
    rng = np.random.default_rng([settings.seed, 63])
    for arm in (planar(4), vera()):
        for kind in ("structural_looseness@link", "backlash@joint"):
            loose, healthy = study(arm, kind, settings)
            cells = []
            for column in range(len(INDICES)):
                one, other = loose[:, column], healthy[:, column]
                draws = rng.integers(len(one), size=(DRAWS, len(one)))
                low, high = np.quantile([auc(one[d], other[d]) for d in draws], [0.025, 0.975])
                cells.append(f"{auc(one, other):.2f} ({low:.2f} to {high:.2f})")
            name = kind.partition("@")[0]
            print(f"{arm.name:10s} {name:22s}" + "".join(f"{cell:>26s}" for cell in cells))


def main(arguments: Sequence[str] | None = None) -> None:
    """Compare, with errors in one line."""
    command("joint_side", __doc__, Settings, compare, arguments)


if __name__ == "__main__":
    main()
