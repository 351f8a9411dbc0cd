"""Joint positions against limits, noted poses and position commands."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from loose_env.doctor.channels import Channel, Machine, Runs, filled, positions
from loose_env.doctor.entries import positions_in
from loose_env.doctor.findings import Finding
from loose_env.doctor.model_checks.units import ANGLE, LENGTH, inverse, named_unit, ratio_of
from loose_env.doctor.settings import DoctorSettings
from loose_env.doctor.thresholds import (
    LEAST_POSE,
    LEAST_SPREAD_RAD,
    MANY_TURNS_RAD,
    OTHER_UNIT,
    OUT_OF_RANGE_M,
    OUT_OF_RANGE_RAD,
    OVER_CONTROL_RANGE,
    SCALE_WRONG,
    SURE_CORRELATION,
    UNIT_MATCH,
)
from loose_env.recording import Run
from loose_env.typing import Array

__all__ = ["check_positions"]

_WRONG_UNIT = "every pose and every prediction of the model is wrong by that factor"
_WRONG_SIGN = "the model is compared in another pose, and its motion runs backwards"
_POINTS = 200
"""Samples of a run that are looked at."""


def check_positions(
    machine: Machine, runs: Runs, settings: DoctorSettings
) -> tuple[list[Finding], dict[str, float]]:
    """Check positions and position commands of all runs together.

    Returns
    -------
    list of Finding
        Findings.
    dict
        Factor that brings the positions of a joint to rad or m and to the model's sign, of the
        joints that need one.
    """
    found: list[Finding] = []
    factors: dict[str, float] = {}
    for joint in machine.joints:
        own = [(run, c[joint]) for run, channels in runs if joint in (c := positions(channels))]
        if not own:
            continue
        reason = _by_pose(machine, joint, own) or _unit(machine, joint, own)
        if reason is not None:
            factors[joint], finding = reason
            found.append(finding)
        else:
            found += _range(machine, joint, own)
    found += _fast(machine, runs, settings)
    found += _commands(machine, runs, factors)
    return found, factors


def _thin(values: Array) -> Array:
    return values[:: max(1, len(values) // _POINTS)]


def _units(machine: Machine, joint: str) -> Mapping[str, float]:
    return ANGLE if machine.hinge(joint) else LENGTH


def _outside(machine: Machine, joint: str, values: Array) -> float:
    """Excess of samples over the limits of its joint [rad or m]."""
    limits = machine.limits(joint)
    if limits is None or not values.size:
        return 0.0
    return float(max(limits[0] - values.min(), values.max() - limits[1], 0.0))


def _slack(machine: Machine, joint: str) -> float:
    return OUT_OF_RANGE_RAD if machine.hinge(joint) else OUT_OF_RANGE_M


def _unit(
    machine: Machine, joint: str, own: Sequence[tuple[Run, Channel]]
) -> tuple[float, Finding] | None:
    """Wrong unit by the joint's limits: outside as it stands, inside once converted."""
    whole = np.concatenate([_thin(channel.there) for _, channel in own])
    if not whole.size:
        return None
    excess = _outside(machine, joint, whole)
    reach = float(np.abs(whole).max())
    limits = machine.limits(joint)
    if limits is None and machine.hinge(joint):
        excess = reach - MANY_TURNS_RAD
    largest = 0.0 if limits is None else max(map(abs, limits))
    if excess <= _slack(machine, joint) or reach < OTHER_UNIT * largest:
        return None
    (words, factor), *_ = _units(machine, joint).items()
    if _outside(machine, joint, whole / factor) > _slack(machine, joint):
        return None
    range_words = "has no limits" if limits is None else f"goes from {limits[0]:.3g} to"
    if limits is not None:
        range_words += f" {limits[1]:.3g} {machine.unit(joint)}"
    certain = limits is not None
    return 1 / factor, Finding(
        check="units",
        severity="error" if certain else "warning",
        channel=own[0][1].name,
        found=f"reaches {reach:.4g}, and joint {joint} {range_words}: probably {words}",
        value=reach,
        unit=machine.unit(joint),
        consequence=_WRONG_UNIT,
        remedy='import the column with its unit (unit = "deg" or "mm"), or convert it',
    )


def _range(machine: Machine, joint: str, own: Sequence[tuple[Run, Channel]]) -> Iterator[Finding]:
    for run, channel in own:
        excess = _outside(machine, joint, channel.there)
        if excess > _slack(machine, joint):
            limits = machine.limits(joint)
            assert limits is not None
            unit = machine.unit(joint)
            yield Finding(
                check="range",
                severity="warning",
                run=run.name,
                channel=channel.name,
                found=f"{excess:.3g} {unit} outside joint {joint}'s limits of {limits[0]:.4g} to "
                f"{limits[1]:.4g} {unit}",
                value=excess,
                unit=unit,
                consequence="the model pushes the joint back into its limits, which the machine "
                "does not",
                remedy="check the zero, the sign and the unit of the encoder, and the limits of "
                "the model",
            )


def _by_pose(
    machine: Machine, joint: str, own: Sequence[tuple[Run, Channel]]
) -> tuple[float, Finding] | None:
    """Wrong unit or sign by the poses noted."""
    pairs = [
        (float(np.mean(there)), run.pose[joint])
        for run, channel in own
        if run.pose is not None and joint in run.pose
        if (there := _thin(channel.there)).size
    ]
    if not pairs:
        return None
    measured, noted = np.array(pairs).T
    if np.abs(noted).max() < LEAST_POSE:
        return None
    found = ratio_of(measured, noted)
    if found is None or abs(found.correlation) < SURE_CORRELATION:
        return None
    (words, factor), *_ = _units(machine, joint).items()
    channel = own[0][1].name
    worst = f"measured {measured[0]:.4g}, noted {noted[0]:.4g} in {own[0][0].name}"
    if named_unit(found.ratio, {words: factor}):
        return 1 / factor, Finding(
            check="units",
            severity="error",
            channel=channel,
            found=f"{abs(found.ratio):.3g} times the pose noted ({worst}): {words}",
            value=abs(found.ratio),
            unit="1",
            consequence=_WRONG_UNIT,
            remedy="import the column with its unit, or convert it",
        )
    if named_unit(inverse(found.ratio), {words: factor}):
        return 1.0, Finding(
            check="units",
            severity="error",
            channel=f"pose of {joint}",
            found=f"{abs(1 / found.ratio):.3g} times the position measured ({worst}): noted in "
            f"{words}",
            value=abs(1 / found.ratio),
            unit="1",
            consequence="the noted pose is not the one that was held",
            remedy="note the pose in rad or m",
        )
    if abs(found.ratio + 1) <= UNIT_MATCH:
        return -1.0, Finding(
            check="sign",
            severity="error",
            channel=channel,
            found=f"has the opposite sign of the pose noted ({worst})",
            value=found.ratio,
            unit="1",
            consequence=_WRONG_SIGN,
            remedy="import the column with sign = -1, or turn the joint's axis in the model",
        )
    return None


def _fast(machine: Machine, runs: Runs, settings: DoctorSettings) -> Iterator[Finding]:
    for run, channels in runs:
        for channel in channels:
            speed = channel.reach
            if channel.kind == "velocity" and speed > settings.fastest:
                unit = f"{machine.unit(channel.of)}/s"
                yield Finding(
                    check="range",
                    severity="warning",
                    run=run.name,
                    channel=channel.name,
                    found=f"reaches {speed:.4g} {unit}",
                    value=speed,
                    unit=unit,
                    consequence="no arm moves so fast: unit, or lost samples",
                    remedy='import the column with its unit ("deg/s", "rpm")',
                )


def _commands(machine: Machine, runs: Runs, factors: Mapping[str, float]) -> Iterator[Finding]:
    for name, drive in machine.drives.items():
        pairs: list[tuple[Array, Array]] = []
        over: tuple[float, Run] | None = None
        for run, channels in runs:
            command = next((c for c in channels if c.name == f"ctrl.{name}"), None)
            if command is None:
                continue
            largest = np.inf if drive.limits is None else max(map(abs, drive.limits))
            reach = command.reach
            if reach > OVER_CONTROL_RANGE * largest and (over is None or reach > over[0]):
                over = (reach, run)
            read = positions_in(run, channels, factors).get(drive.joint)
            if read is not None and drive.follows:
                given = filled(run.time, command.values)
                pairs.append((_thin(given), _thin(read) * drive.gear))
        wrong = _following(machine, name, drive.joint, pairs)
        if wrong is not None:
            yield wrong
        elif over is not None:
            yield Finding(
                check="range",
                severity="warning",
                run=over[1].name,
                channel=f"ctrl.{name}",
                found=f"reaches {over[0]:.4g}, and the actuator's limits are {drive.limits}",
                value=over[0],
                consequence="the model clips the command, and the machine did not",
                remedy="check the unit of the command (the actuator's own), and ctrlrange of the "
                "model",
            )


def _following(
    machine: Machine, name: str, joint: str, pairs: Sequence[tuple[Array, Array]]
) -> Finding | None:
    """Position command in another unit, or with the opposite sign, of the position."""
    if not pairs:
        return None
    command, read = (np.concatenate(each) for each in zip(*pairs, strict=True))
    if np.sqrt(np.mean(read**2)) < LEAST_SPREAD_RAD:
        return None
    found = ratio_of(command, read)
    if found is None or abs(found.correlation) < SURE_CORRELATION:
        return None
    units = _units(machine, joint)
    words = named_unit(found.ratio, units) or named_unit(inverse(found.ratio), units)
    opposite = abs(found.ratio + 1) <= UNIT_MATCH
    if words is None and not opposite and 1 / SCALE_WRONG < abs(found.ratio) < SCALE_WRONG:
        return None
    if words is not None:
        explained = f": one of the two is in {words}"
    else:
        explained = ": opposite signs" if opposite else ": another unit or gear"
    return Finding(
        check="sign" if opposite else "units",
        severity="error" if words or opposite else "warning",
        channel=f"ctrl.{name}",
        found=f"{found.ratio:.3g} times the measured position of joint {joint}{explained}",
        value=found.ratio,
        unit="1",
        consequence="the model follows a command that the machine was not given",
        remedy="import the column with its unit, or with sign = -1",
    )
