"""Measure only as long as the wanted angle needs (thesis 8.1.1).

Short records of a pose, every joint in turn, are pooled until the 95 % interval of the direction of
looseness is as narrow as wanted. The interval comes from leaving one record out at a time (delete-1
jackknife). Scatter falls with the root of time, so that half the angle takes four times as long;
what sensors and model get wrong does not fall at all.

Usage: python scripts/thesis/stopping.py --arms 32
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from loose_env.arms import planar
from loose_env.cli.command import command
from loose_env.envs import Difficulty
from loose_env.io import Count
from loose_env.typing import Array
from scripts.thesis.twins import Twins, angle_deg, change_of

WANTED = (5.0, 2.0, 1.0, 0.5)
"""Half widths of the interval at which a measurement stops [deg]."""
FIRST = 4
"""Records before the first look: fewer tell little of their scatter."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of the study."""

    arms: Count = 32
    """Arms, each with its own fault, mismatch and pose."""
    records: Count = 24
    """Most records of each joint."""
    seconds: float = 0.2
    """Length of a record [s]."""
    level: Count = 3
    """Excitation level, from 1."""
    seed: int = 0
    """Root of all draws."""


def axis_of(change: Array) -> Array:
    """Direction of a change of transmission (d, joints): its largest left singular vector."""
    return np.asarray(np.linalg.svd(change)[0][:, 0])


def half_width(changes: Array) -> float:
    """Half width of the direction's 95 % interval [deg] from records (R, d, joints)."""
    count, pooled = len(changes), axis_of(changes.mean(axis=0))
    left_out = [
        angle_deg(axis_of(np.delete(changes, r, axis=0).mean(axis=0)), pooled) for r in range(count)
    ]
    deviation = np.sqrt((count - 1) / count * np.sum(np.square(left_out)))
    return float(student.ppf(0.975, count - 1) * deviation)


def study(settings: Settings) -> tuple[Array, list[Array]]:
    """Changes of transmission of every record (arms, R, d, joints), and the true directions."""
    arm = planar(3)
    twins = Twins.draw(
        arm, settings.arms, [settings.seed, 81], difficulty=Difficulty(friction=(0.02, 0.1))
    )
    shape = (settings.arms, settings.records, len(arm.axes), arm.n)
    changes = np.zeros(shape)
    for joint in range(arm.n):
        level = arm.levels[settings.level - 1]
        shakes = twins.one_joint(joint, level, duration=settings.seconds)
        for r in range(settings.records):
            for k, pair in enumerate(twins.measure(shakes, [settings.seed, 82, joint, r])):
                if pair is not None:
                    changes[k, r, :, joint] = change_of(pair, joint)
    return changes, [twins.slide(k) for k in range(settings.arms)]


def compare(settings: Settings) -> None:
    """Run the study and print a row for each angle wanted."""
    changes, truths = study(settings)
    print(f"planar arm of 3 links, {settings.arms} arms, records of {settings.seconds:g} s a joint")
    print(f"{'wanted':>8s} {'reached':>9s} {'seconds':>9s} {'median error':>14s} {'within':>8s}")
    for wanted in WANTED:
        reached, spent, errors = [], [], []
        for records, truth in zip(changes, truths, strict=True):
            for count in range(FIRST, settings.records + 1):
                width = half_width(records[:count])
                if width <= wanted or count == settings.records:
                    break
            reached.append(width <= wanted)
            spent.append(count * settings.seconds)
            errors.append(angle_deg(axis_of(records[:count].mean(axis=0)), truth))
        within = np.mean(np.array(errors) <= wanted)
        print(
            f"{wanted:6g} ° {100 * np.mean(reached):7.0f} % {np.median(spent):9.1f} "
            f"{np.median(errors):12.1f} ° {100 * within:6.0f} %"
        )
    print("seconds: of records for each joint, median; within: errors no larger than wanted")


def main(arguments: Sequence[str] | None = None) -> None:
    """Compare, with errors in one line."""
    command("stopping", __doc__, Settings, compare, arguments)


if __name__ == "__main__":
    main()
