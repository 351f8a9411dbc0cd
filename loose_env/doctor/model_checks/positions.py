"""Check of joint positions against limits, noted poses and position commands."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from loose_env.doctor.channels import Channel, Factors, Machine, Runs, filled, positions
from loose_env.doctor.entries import positions_in
from loose_env.doctor.findings import Finding
from loose_env.doctor.model_checks.by_run import judged_runs
from loose_env.doctor.model_checks.units import ANGLE, LENGTH, Ratio, inverse, named_unit, ratio_of
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

_WRONG_UNIT = "every pose and every prediction of the model is wrong by that factor"
_CONVERT = 'import the column with its unit (unit = "deg" or "mm"), or convert it'
_WRONG_SIGN = "the model is compared in another pose, and its motion runs backwards"
_UNIT, _SIGN, _NOTED = "unit", "sign", "unit of the pose"
_POINTS = 200
"""Samples of a run that are looked at."""


def check_positions(
    machine: Machine, runs: Runs, settings: DoctorSettings
) -> tuple[list[Finding], dict[tuple[str, str], float]]:
    """Check positions and position commands, of all runs together where they agree."""
    found: list[Finding] = []
    factors: dict[tuple[str, str], float] = {}
    told = _told(machine, runs, settings)
    for joint in machine.joints:
        own = {
            run.name: (run, c[joint])
            for run, channels in runs
            if joint in (c := positions(channels))
        }

        def verdict(run: str, _: object, joint: str = joint) -> str | None:
            return told.get((run, joint))

        for name, parts in judged_runs(own, verdict):
            reason = _by_pose(machine, joint, parts) or _unit(machine, joint, parts)
            if reason is None and name and told[name, joint] == _UNIT:
                reason = _as_others(machine, joint, parts[0][1])
            if reason is None:
                found += _range(machine, joint, parts)
                continue
            factor, finding = reason
            factors |= {(run.name, joint): factor for run, _ in parts}
            found.append(replace(finding, run=name))
    found += _fast(machine, runs, settings)
    found += _commands(machine, runs, factors)
    return found, factors


def _told(machine: Machine, runs: Runs, settings: DoctorSettings) -> dict[tuple[str, str], str]:
    """Unit and sign that a run by itself tells of its positions: "" for the right ones."""
    told: dict[tuple[str, str], str] = {}
    for run, channels in runs:
        measured = positions(channels)
        said = {joint: _alone(machine, joint, run, c, settings) for joint, c in measured.items()}
        noted = [j for j in measured if abs((run.pose or {}).get(j, 0.0)) >= LEAST_POSE]
        # An entry that fits no joint but for its sign is that of another run.
        believed = all(said[joint] is not None for joint in noted)
        for joint, words in said.items():
            if words is not None and (believed or words != _SIGN):
                told[run.name, joint] = words
    for hinge in (True, False):
        _by_other_joints({j for j in machine.joints if machine.hinge(j) == hinge}, runs, told)
    return told


def _by_other_joints(joints: set[str], runs: Runs, told: dict[tuple[str, str], str]) -> None:
    """Add what a run's other joints tell: a recorder has one unit for all of one kind."""
    for run, channels in runs:
        own = joints & set(positions(channels))
        said = [told.get((run.name, joint)) for joint in own]
        if said.count(_UNIT) > len(own) / 2 and set(said) <= {_UNIT, None}:
            told |= {(run.name, joint): _UNIT for joint in own}
    wrong = {joint for (_, joint), words in told.items() if words == _UNIT} & joints
    for run, channels in runs:
        judged = {j: c.there for j, c in positions(channels).items() if j in wrong}
        if not any(v.size and abs(np.mean(v)) >= LEAST_POSE for v in judged.values()):
            continue  # near zero in any unit
        words = _UNIT if any(told.get((run.name, j)) == _UNIT for j in judged) else ""
        for joint in judged:
            told.setdefault((run.name, joint), words)


def _alone(
    machine: Machine, joint: str, run: Run, channel: Channel, settings: DoctorSettings
) -> str | None:
    """Judge one joint of one run by its pose and its limits; None where they tell nothing."""
    part = [(run, channel)]
    noted = (run.pose or {}).get(joint, 0.0)
    values = channel.there
    if values.size and abs(noted) >= LEAST_POSE:
        mean = float(np.mean(values))
        if abs(mean - noted) <= max(settings.pose_offset, UNIT_MATCH * abs(noted)):
            return ""
        if abs(mean + noted) <= settings.pose_offset:
            return _SIGN
        by_pose = _by_pose(machine, joint, part)
        if by_pose is not None and by_pose[1].check == "units":
            return _UNIT if by_pose[0] != 1.0 else _NOTED
    return _UNIT if _unit(machine, joint, part) is not None else None


def _as_others(machine: Machine, joint: str, channel: Channel) -> tuple[float, Finding]:
    """Wrong unit of a joint near zero, by that of the other joints of its run."""
    (words, factor), *_ = _units(machine, joint).items()
    return 1 / factor, Finding(
        check="units",
        severity="error",
        channel=channel.name,
        found=f"reaches {channel.reach:.4g}, and other positions of this run are {words}",
        value=channel.reach,
        unit=machine.unit(joint),
        consequence=_WRONG_UNIT,
        remedy=_CONVERT,
    )


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
        remedy=_CONVERT,
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


def _commands(machine: Machine, runs: Runs, factors: Factors) -> Iterator[Finding]:
    for name, drive in machine.drives.items():
        pairs: dict[str, tuple[Array, Array]] = {}
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
                pairs[run.name] = _thin(given), _thin(read) * drive.gear

        def unit(_: str, pair: tuple[Array, Array], joint: str = drive.joint) -> str | None:
            return _followed(machine, joint, [pair])

        wrong = []
        for of, some in judged_runs(pairs, unit):
            made = _following(machine, name, drive.joint, some)
            wrong += [] if made is None else [replace(made, run=of)]
        if wrong:
            yield from wrong
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


def _followed(machine: Machine, joint: str, pairs: Sequence[tuple[Array, Array]]) -> str | None:
    """Judge the command of one run: "" for the right unit; None where it tells nothing."""
    found = _command_ratio(pairs)
    if found is None:
        return None
    wrong = _following(machine, "", joint, pairs)
    if wrong is not None:
        return wrong.check if wrong.severity == "error" else None
    return ""


def _command_ratio(pairs: Sequence[tuple[Array, Array]]) -> Ratio | None:
    command, read = (np.concatenate(each) for each in zip(*pairs, strict=True))
    if np.sqrt(np.mean(read**2)) < LEAST_SPREAD_RAD:
        return None
    found = ratio_of(command, read)
    return None if found is None or abs(found.correlation) < SURE_CORRELATION else found


def _following(
    machine: Machine, name: str, joint: str, pairs: Sequence[tuple[Array, Array]]
) -> Finding | None:
    """Position command in another unit, or with the opposite sign, of the position."""
    found = _command_ratio(pairs)
    if found is None:
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
