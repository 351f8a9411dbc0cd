"""Direction of looseness on VERA with compensated excitation against flat torque (thesis 8.2.2).

The thesis proposes to estimate the transfer function in a pose and to shape the random signal by
its inverse. Each joint is excited in turn by flat torque, by torque that makes the joint's motion
white, and by torque that makes the tool's motion white; the transfer functions are measured on a
healthy record of the same arm, as they would be on a real one. The rms acceleration of the nominal
tool is the same each time. Loose and healthy records give the direction of lowest correlation and
that of the change of transmission; the study keeps their angles to the true direction.

Usage: python scripts/studies/thesis/compensation.py [--arms 64] [--level 3] [--seed 0]
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
from loose_agents.execution.command import command, option
from loose_agents.execution.progress import ProgressLine

from loose_env.arms import CREST_FACTOR, Arm, LinearArm, LinearPose, vera
from loose_env.diagnosis import statistics_of
from loose_env.envs import Difficulty, FaultSampler
from loose_env.excitation import Excitation, Shaping, at_levels
from loose_env.faults import Healthy, StructuralLooseness
from loose_env.io import Count
from loose_env.rig import Job, Measurement, SimulatedRig
from loose_env.statistics import (
    acceleration_from_angle,
    axial_difference,
    transfer_function,
)
from loose_env.thesis.methods.motion.signals import spectral_flatness
from loose_env.typing import Array
from scripts.study_parts.arms import seat_in_tool

Compensation = Literal["flat torque", "white joint motion", "white tool motion"]
COMPENSATIONS: tuple[Compensation, ...] = get_args(Compensation)
DURATION = 1.2
"""Length of a record [s], as in the thesis."""
RANGE = 10.0
"""Largest over smallest amplitude of the shaped torque [1]: so that a deep antiresonance does not
take all the power."""
CLOSE = 20.0
"""Error of a direction that the thesis claims [deg] (6.5.1)."""
DRAWS = 2000
"""Resamples of arms for the 95 % intervals of differences."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of the study."""

    arms: Count = option(64, "arms, each with its own fault, mismatch and pose")
    level: Count = option(3, "excitation level, from 1")
    seed: int = option(0, "root of all draws")


def inverse_of(frequency: Array, size: Array) -> Shaping:
    """Amplitude 1 / ``size`` at each frequency, within `RANGE` about its median."""
    inverse = 1 / np.maximum(size, 1e-12 * size.max())
    middle = np.median(inverse)
    inverse = np.clip(inverse, middle / np.sqrt(RANGE), middle * np.sqrt(RANGE))
    return lambda at: np.asarray(np.interp(at, frequency, inverse))


def shaping_of(healthy: Measurement, joint: int, kind: Compensation) -> Shaping | None:
    """Shape of a joint's torque (from 0) by the transfer function of a healthy flat record."""
    if kind == "flat torque":
        return None
    rate, (low, high) = healthy.rate, healthy.excitation.band
    motion: Array = healthy.tool
    if kind == "white joint motion":
        motion = acceleration_from_angle(healthy.encoder[[joint]], rate, (low, high))
    found = transfer_function(healthy.command[joint], motion, rate, segments=8)
    inside = (found.frequencies >= low) & (found.frequencies <= high)
    size = np.sqrt(np.sum(np.abs(found.response[:, inside]) ** 2, axis=0))
    return inverse_of(found.frequencies[inside], size)


def shaped(flat: Excitation, pose: LinearPose, joint: int, shape: Shaping | None) -> Excitation:
    """Shape the torque of one joint (from 0) at the same rms motion of the nominal tool."""
    if shape is None:
        return flat
    arm = pose.linear.arm
    power = np.sum(np.abs(pose.response(flat.excited).tool[:, :, 0]) ** 2, axis=1)
    weight = shape(pose.linear.frequency) ** 2
    factor = np.sqrt(power.mean() / ((weight * power).mean() / weight.mean()))
    spare = arm.torque_limits[joint] - abs(pose.gravity_torque[joint])
    torque = list(flat.torque_rms)
    torque[joint] = min(torque[joint] * float(factor), spare / CREST_FACTOR)
    return replace(
        flat,
        torque_rms=tuple(torque),
        shaping=tuple(shape if j == joint else None for j in range(arm.n)),
    )


def errors_of(loose: Measurement, healthy: Measurement, truth: float) -> tuple[float, float]:
    """Angle to the truth of the lowest correlation and of the change of transmission [deg]."""
    found, reference = statistics_of(loose), statistics_of(healthy)
    change = found.transmission_by_instrument - reference.transmission_by_instrument
    angles = (
        np.arctan2(found.lowest_direction[1], found.lowest_direction[0]),
        np.arctan2(change[1, 0], change[0, 0]),
    )
    lowest, changed = (abs(float(np.degrees(axial_difference(a, truth)))) for a in angles)
    return lowest, changed


def study(arm: Arm, settings: Settings) -> dict[Compensation, tuple[Array, Array]]:
    """Errors (cases, 2) [deg] and flatness (cases,) of the healthy joint motion of each excitation.

    A case is an arm and its excited joint.
    """
    linear, difficulty = LinearArm(arm), Difficulty()
    sampler = FaultSampler(linear, difficulty)
    rig = SimulatedRig(arm, slots=2 * settings.arms)
    poses, truths = [], []
    for k in range(settings.arms):
        rng = np.random.default_rng([settings.seed, 51, k])
        fault = sampler.draw(rng, hypothesis=f"structural_looseness@link{1 + k % arm.n}")
        assert isinstance(fault, StructuralLooseness)
        mismatch = difficulty.mismatch.draw(arm, rng)
        rig.mount(2 * k, fault, mismatch)
        rig.mount(2 * k + 1, Healthy(), mismatch)
        poses.append(arm.random_pose(rng))
        seen, _ = seat_in_tool(arm, poses[-1], fault)
        truths.append(float(np.arctan2(seen[1], seen[0])))
    errors: dict[Compensation, list[tuple[float, float]]] = {kind: [] for kind in COMPENSATIONS}
    flatness: dict[Compensation, list[float]] = {kind: [] for kind in COMPENSATIONS}
    with ProgressLine(arm.n * len(COMPENSATIONS), unit="sets of records") as line:
        for joint in range(arm.n):
            levels = np.where(np.arange(arm.n) == joint, arm.levels[settings.level - 1], 0.0)
            flat = [at_levels(linear.at(q), levels, duration=DURATION)[0] for q in poses]
            reference: list[Measurement] = []
            for number, kind in enumerate(COMPENSATIONS):
                jobs = []
                for k, pose in enumerate(poses):
                    shape = shaping_of(reference[k], joint, kind) if reference else None
                    excitation = shaped(flat[k], linear.at(pose), joint, shape)
                    for twin in (0, 1):
                        key = [settings.seed, 52, k, joint, number, twin]
                        rng = np.random.default_rng(key)
                        jobs.append(
                            Job(slot=2 * k + twin, pose=pose, excitation=excitation, rng=rng)
                        )
                measured = rig.measure_many(jobs)
                if not reference:
                    reference = measured[1::2]
                for k, truth in enumerate(truths):
                    loose, healthy = measured[2 * k], measured[2 * k + 1]
                    failed = loose.failure or healthy.failure
                    pair = (np.nan, np.nan) if failed else errors_of(loose, healthy, truth)
                    errors[kind].append(pair)
                    motion = acceleration_from_angle(healthy.encoder[joint], healthy.rate, arm.band)
                    flatness[kind].append(
                        float(spectral_flatness(motion, healthy.rate, arm.band, segments=8))
                    )
                line.advance(1)
    return {kind: (np.array(errors[kind]), np.array(flatness[kind])) for kind in COMPENSATIONS}


def difference(one: Array, other: Array, arms: int, seed: int) -> tuple[float, float, float]:
    """Difference of median errors [deg] and its 95 % interval, by resampling arms.

    ``one``, ``other`` (cases,): paired; the cases of an arm lie ``arms`` apart.
    """
    rng = np.random.default_rng([seed, 53])
    pairs = np.stack([one, other]).reshape(2, -1, arms)
    draws = rng.integers(arms, size=(DRAWS, arms))
    found = [np.nanmedian(pairs[:, :, d].reshape(2, -1), axis=1) for d in draws]
    turns = np.diff(np.array(found), axis=1)[:, 0]
    low, high = np.quantile(turns, [0.025, 0.975])
    return float(np.nanmedian(other) - np.nanmedian(one)), float(low), float(high)


def compare(settings: Settings) -> None:
    """Run the study and print a row for each excitation and estimator."""
    found = study(vera(), settings)
    print(f"VERA, {settings.arms} arms, each joint in turn, level {settings.level}")
    head = ("excitation", "flatness", "direction by", "median error", "within 20 deg", "difference")
    print("{:20s} {:>8s}   {:22s} {:>12s} {:>14s}   {}".format(*head))
    base = found[COMPENSATIONS[0]][0]
    for kind, (errors, flatness) in found.items():
        for column, name in enumerate(("lowest correlation", "change of transmission")):
            values = errors[:, column]
            shift = "-"
            if kind != COMPENSATIONS[0]:
                middle, low, high = difference(
                    base[:, column], values, settings.arms, settings.seed
                )
                shift = f"{middle:+.1f} ({low:+.1f} to {high:+.1f})"
            print(
                f"{kind:20s} {np.median(flatness):8.2f}   {name:22s}"
                f" {np.nanmedian(values):12.1f} {100 * np.mean(values < CLOSE):12.0f} %   {shift}"
            )
    print("difference: of the median error against flat torque [deg], with its 95 % interval")


def main(arguments: Sequence[str] | None = None) -> None:
    """Compare, with errors in one line."""
    command("compensation", __doc__, Settings, compare, arguments)


if __name__ == "__main__":
    main()
