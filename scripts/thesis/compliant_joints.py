"""Direction of looseness as the joints that hold the arm become compliant (thesis 8.2.1).

The way in which an arm holds its joints is softened from stiff brakes through position servos of
300 Hz to far below the band of the excitation. Every joint is excited in turn, once with the seat
loose and once on the healthy twin; estimators of the direction are compared by their median angle
to the truth: against healthy records, against rigid kinematics, and against the dynamic model.

Usage: python scripts/thesis/compliant_joints.py --cases 18
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from loose_env.arms import Arm, planar, servoed
from loose_env.cli.command import command
from loose_env.diagnosis import SensorFloor, predict, statistics_of
from loose_env.envs import Difficulty
from loose_env.io import Count
from loose_env.typing import Array
from scripts.thesis.twins import Twins, angle_deg

MODES = (300.0, 150.0, 100.0, 70.0, 30.0, 15.0)
"""Mode of each joint on its servo, all others held [Hz]."""
ESTIMATORS = ("healthy records", "kinematics", "dynamic model")
LEVEL = 3.0
"""Rms acceleration at the nominal tool [m/s²]."""
OPEN = Difficulty(gap=(0.03e-3, 0.4e-3), friction=(0.02, 0.1))
"""Gaps [m] and friction over the seat drive of the top level: seats that open."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of the study."""

    cases: Count = 18
    """Faults and poses for each way of holding."""
    links: Count = 3
    """Links of the planar arm."""
    seed: int = 0
    """Root of all draws."""


def errors_of(arm: Arm, settings: Settings) -> tuple[Array, float]:
    """Errors of each estimator (cases, estimators) [deg], and the median change of transmission.

    The change is relative to the healthy arm's.
    """
    twins = Twins.draw(arm, settings.cases, [settings.seed], difficulty=OPEN)
    floor = SensorFloor.of(twins.rig.sensors, arm.band)
    shape = (settings.cases, 4, len(arm.axes), arm.n)
    columns = np.full(shape, np.nan)  # loose, healthy, kinematic, modelled
    for joint in range(arm.n):
        shakes = twins.one_joint(joint, LEVEL)
        for k, pair in enumerate(twins.measure(shakes, [settings.seed, 1, joint])):
            if pair is None:
                continue
            at = twins.linear.at(twins.poses[k])
            model = predict(at, shakes[k], floor).transmission_by_instrument[:, 0]
            seen = (statistics_of(m).transmission_by_instrument[:, joint] for m in pair)
            columns[k, :, :, joint] = [*seen, at.kinematic[:, joint], model]
    errors, ratios = [], []
    for k, (loose, *references) in enumerate(columns):
        if np.isfinite(loose).all():
            axes = [np.linalg.svd(loose - other)[0][:, 0] for other in references]
            errors.append([angle_deg(axis, twins.slide(k)) for axis in axes])
            healthy = references[0]
            ratios.append(np.linalg.norm(loose - healthy) / np.linalg.norm(healthy))
    return np.array(errors), float(np.median(ratios))


def compare(settings: Settings) -> None:
    """Run the study and print a row for each way of holding."""
    stiff = planar(settings.links)
    print(
        f"{stiff.name}, {settings.cases} cases a row: median error of the direction [deg] against"
    )
    print(f"{'held by':14s} {'|dB|/|B|':>9s}" + "".join(f"{e:>17s}" for e in ESTIMATORS))
    arms = {"brakes": stiff} | {f"servo {m:.0f} Hz": servoed(stiff, mode_hz=m) for m in MODES}
    for name, arm in arms.items():
        errors, ratio = errors_of(arm, settings)
        middle = "".join(f"{error:17.1f}" for error in np.median(errors, axis=0))
        print(f"{name:14s} {ratio:9.2f}{middle}")


def main(arguments: Sequence[str] | None = None) -> None:
    """Compare, with errors in one line."""
    command("compliant_joints", __doc__, Settings, compare, arguments)


if __name__ == "__main__":
    main()
