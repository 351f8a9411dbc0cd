"""One accelerometer at the tool against one on every link as well (thesis 8.3.3, 8.3.4).

Hidden slides at random links, in one random pose each; every joint is excited in turn on the loose
arm and on its healthy twin. At each accelerometer the acceleration across the arm's plane of motion
is regressed on the excited joint's command; the change from the twin, over what it is between two
healthy records, says that something is loose. A seat changes what lies beyond it most: the first
link whose sensor changes by half of the largest change is named. The tool alone sees that something
is loose, and its direction, but in one pose not where.

Usage: python scripts/thesis/sensors.py --arms 32 --level 3
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from loose_env.arms import Arm, planar, vera
from loose_env.cli.command import command
from loose_env.io import Count
from loose_env.rig import Measurement
from loose_env.sensors import LinkAccelerometers, SensorSuite
from loose_env.statistics import bandpass
from loose_env.typing import Array
from scripts.thesis.twins import Twins, angle_deg, change_of

FALSE_ALARMS = 0.05
"""Share of healthy arms that pass the threshold of detection."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of the study."""

    arms: Count = 32
    """Arms of each kind, each with its own fault, mismatch and pose."""
    level: Count = 3
    """Excitation level, from 1."""
    seed: int = 0
    """Root of all draws."""


def gains(record: Measurement, joint: int) -> Array:
    """Acceleration of every link (rows) and of the tool per command of a joint (links + 1, 3)."""
    rate, band = record.rate, record.excitation.band
    command = bandpass(record.command[joint], rate, band)
    tool, links = record.tool, record.links
    assert links is not None
    padded = np.zeros((1, links.shape[1], tool.shape[1]))
    padded[0, : len(tool)] = tool
    signals = bandpass(np.concatenate([links, padded]), rate, band)
    return np.asarray(signals @ command / (command @ command))


def study(arm: Arm, settings: Settings) -> tuple[Array, Array, Array, Array]:
    """Changes at each sensor of loose and of healthy arms, loose links, and direction errors [deg].

    Changes (arms, links + 1) are root sums of squares over the excited joints, relative to the
    healthy gains.
    """
    every = LinkAccelerometers()
    suite = SensorSuite(link_accelerometers=every)
    twins = Twins.draw(arm, settings.arms, [settings.seed, 71], sensors=suite)
    loose, quiet = np.zeros((2, settings.arms, arm.n + 1))
    tool = np.zeros((settings.arms, arm.n, len(arm.axes)))
    for joint in range(arm.n):
        shakes = twins.one_joint(joint, arm.levels[settings.level - 1])
        first, second = (twins.measure(shakes, [settings.seed, 72, joint, r]) for r in (0, 1))
        for k, (pair, again) in enumerate(zip(first, second, strict=True)):
            if pair is None or again is None:
                continue
            seen, before, after = (gains(m, joint) for m in (*pair, again[1]))
            size = np.linalg.norm(before, axis=1) + 1e-12
            loose[k] += (np.linalg.norm(seen - before, axis=1) / size) ** 2
            quiet[k] += (np.linalg.norm(after - before, axis=1) / size) ** 2
            tool[k, joint] = change_of(pair, joint)
    directions = [np.linalg.svd(change)[2][0] for change in tool]
    errors = np.array([angle_deg(u, twins.slide(k)) for k, u in enumerate(directions)])
    links = np.array([fault.link for fault in twins.faults])  # type: ignore[union-attr]
    return np.sqrt(loose), np.sqrt(quiet), links, errors


def compare(settings: Settings) -> None:
    """Run the study and print a row for each arm and set of sensors."""
    print(f"{settings.arms} arms, each joint in turn in one pose, level {settings.level}")
    print(
        f"{'arm':9s} {'sensors':20s} {'detected':>9s} {'link right':>11s} {'direction error':>16s}"
    )
    for arm in (vera(), planar(4)):
        loose, quiet, links, errors = study(arm, settings)
        noise = np.median(quiet, axis=0)  # a sensor that hardly moves scatters most
        for name, sensors in (("tool", [arm.n]), ("tool + all links", list(range(arm.n + 1)))):
            most = loose[:, sensors].max(axis=1)
            seen, healthy = ((x / noise)[:, sensors].max(axis=1) for x in (loose, quiet))
            found = seen > np.quantile(healthy, 1 - FALSE_ALARMS, method="higher")
            # The last sensor is the tool's, which is carried by the last link.
            first = np.argmax(loose[:, sensors] > 0.5 * most[:, None], axis=1)
            named = np.minimum(1 + first, arm.n) if len(sensors) > 1 else np.full(len(links), arm.n)
            right = np.mean(named == links)
            print(
                f"{arm.name:9s} {name:20s} {100 * found.mean():7.0f} % {100 * right:9.0f} % "
                f"{np.median(errors):12.1f} deg"
            )


def main(arguments: Sequence[str] | None = None) -> None:
    """Compare, with errors in one line."""
    command("sensors", __doc__, Settings, compare, arguments)


if __name__ == "__main__":
    main()
