"""Checks of what recording.json notes of a run: pose, excited joints, commands."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from scipy import signal

from loose_env.doctor.channels import Channel, Factors, Machine, Runs, filled, positions
from loose_env.doctor.findings import Finding
from loose_env.doctor.settings import DoctorSettings
from loose_env.doctor.thresholds import POSE_SPREAD, SILENT_COMMAND
from loose_env.recording import Run

_RECORD = "note the pose that was held, or record the run again in that pose"


def positions_in(run: Run, channels: Sequence[Channel], factors: Factors) -> dict[str, np.ndarray]:
    """Measured position of each joint, brought to rad or m by the factors found."""
    return {
        joint: filled(run.time, channel.values) * factors.get((run.name, joint), 1.0)
        for joint, channel in positions(channels).items()
    }


def check_entries(
    machine: Machine,
    pairs: Runs,
    factors: Factors,
    settings: DoctorSettings,
) -> Iterator[Finding]:
    """Compare the entries of all runs with their columns."""
    runs = [run for run, _ in pairs]
    for run, own in pairs:
        measured = positions_in(run, own, factors)
        mean = {joint: float(np.mean(q)) for joint, q in measured.items()}
        if run.pose is not None:
            yield from _pose(machine, run, own, mean, runs, factors, settings)
        yield from _commands(machine, run, own)
    yield from _missing_commands(machine, runs)
    with_commands = [bool(run.controls or run.torques) for run in runs]
    for run, has in zip(runs, with_commands, strict=True):
        if not has and any(with_commands):
            yield Finding(
                check="commands",
                severity="warning",
                run=run.name,
                channel="ctrl",
                found="no command and no torque, and other runs have them",
                consequence="the run is taken for a free response from its initial state",
                remedy="record the commands in every run",
            )


def _missing_commands(machine: Machine, runs: Sequence[Run]) -> Iterator[Finding]:
    """Actuators of the model whose commands were not recorded, nor the torques of their joints."""
    # Sessions of 'loose plan' hold a pose: what shakes them is in the plan.
    moved = [run for run in runs if run.pose is None]
    if machine.drives and moved and not any(run.controls or run.torques for run in runs):
        yield Finding(
            check="commands",
            severity="warning",
            channel="ctrl",
            found=f"no commands and no torques, and the model has actuators "
            f"({_some(list(machine.drives))})",
            consequence="every run is taken for a free response, its drives off",
            remedy="record the commands or the joint torques; let go of the arm for free responses",
        )
    for run in runs:
        if run.excited or not run.controls:
            continue  # the other joints are braked, or nothing is driven
        missing = [
            name
            for name, drive in machine.drives.items()
            if name not in run.controls and drive.joint not in run.torques
        ]
        if missing:
            yield Finding(
                check="commands",
                severity="warning",
                run=run.name,
                channel=f"ctrl.{missing[0]}",
                found=f"no command of {_some(missing)}, and other actuators have theirs",
                consequence="simulated with a command of 0",
                remedy="record the commands of all actuators of the model, or take out those that "
                "the machine has not",
            )


def _some(names: Sequence[str]) -> str:
    """List names, the first three of many."""
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")


def _pose(
    machine: Machine,
    run: Run,
    channels: Sequence[Channel],
    mean: Mapping[str, float],
    runs: Sequence[Run],
    factors: Factors,
    settings: DoctorSettings,
) -> Iterator[Finding]:
    assert run.pose is not None
    for joint, q in positions_in(run, channels, factors).items():
        spread = float(np.std(q))
        if joint in run.pose and spread > POSE_SPREAD:
            unit = machine.unit(joint)
            yield Finding(
                check="pose",
                severity="warning",
                run=run.name,
                channel=joint,
                found=f"moves by {spread:.3g} {unit} rms, and a held pose is noted",
                value=spread,
                unit=unit,
                consequence="a diagnosis refuses a run that moves through poses",
                remedy="hold the pose, or leave 'pose' out and use 'loose gap'",
            )
    off = _distance(mean, run.pose)
    if off is None or off[1] <= settings.pose_offset:
        return
    joint, worst = off
    other = next(
        (
            each.name
            for each in runs
            if each is not run
            and each.pose is not None
            and (other_off := _distance(mean, each.pose)) is not None
            and other_off[1] <= settings.pose_offset
        ),
        None,
    )
    unit = machine.unit(joint)
    found = f"measured {mean[joint]:.4g} {unit}, noted {run.pose[joint]:.4g} {unit}"
    yield Finding(
        check="pose",
        severity="warning",
        run=run.name,
        channel=joint,
        found=found if other is None else f"{found}: the pose noted for {other}",
        value=worst,
        unit=unit,
        consequence="the measured pose is used; where the entry is right, the encoder is not",
        remedy=_RECORD
        if other is None
        else "check the order of the runs in recording.json: two entries seem exchanged",
    )


def _distance(mean: Mapping[str, float], pose: Mapping[str, float]) -> tuple[str, float] | None:
    """Joint that is farthest from a pose, and by how much [rad or m]."""
    both = [(joint, abs(mean[joint] - q)) for joint, q in pose.items() if joint in mean]
    return max(both, key=lambda each: each[1]) if both else None


def _commands(machine: Machine, run: Run, channels: Sequence[Channel]) -> Iterator[Finding]:
    if not run.excited:
        return
    power: dict[str, float] = {}
    for channel in channels:
        drive = machine.drives.get(channel.of) if channel.kind == "command" else None
        joint = channel.of if channel.kind == "torque" else drive.joint if drive else ""
        if joint:
            scale = 1.0 if drive is None else abs(drive.gear * (drive.gain or 1.0))
            wobble = float(np.std(signal.detrend(filled(run.time, channel.values))))
            power[joint] = max(power.get(joint, 0.0), scale * wobble)
    strongest = max(power.values(), default=0.0)
    for joint in run.excited:
        if joint not in power:
            yield Finding(
                check="commands",
                severity="warning",
                run=run.name,
                channel=joint,
                found="noted as excited, and neither its command nor its torque was recorded",
                consequence="the force that excites the arm is not known, only its motion",
                remedy="record the column 'ctrl.' of its actuator, or 'torque.' of the joint",
            )
        elif power[joint] <= SILENT_COMMAND * strongest or strongest == 0.0:
            yield Finding(
                check="commands",
                severity="warning",
                run=run.name,
                channel=joint,
                found="noted as excited, and its command does not move",
                value=power[joint],
                unit="N·m or N",
                consequence="the run is read as if this joint had been shaken",
                remedy="correct 'excited' in recording.json, or the column of the command",
            )
