"""`examine`: all checks of the preflight run on a recording, and the report of findings."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from loose_env.arms import quiet
from loose_env.doctor.channels import (
    HIGHEST_RATE_HZ,
    check_channels,
    check_sampling,
    without_absurd,
    without_dead,
)
from loose_env.doctor.clocks import check_clocks
from loose_env.doctor.corrections import corrected
from loose_env.doctor.findings import DoctorSettings, Finding, Report
from loose_env.doctor.machine import BLOCK_S, Machine, Motion, motion_of
from loose_env.doctor.positions import check_entries, check_positions, check_turns
from loose_env.doctor.signals import (
    check_commands,
    check_forces,
    check_gravity,
    check_kinematics,
)
from loose_env.doctor.torques import check_torques, confirmed
from loose_env.importing import median_step
from loose_env.recording import Recording, Run

MOST_SPECTRA = 8
"""Runs whose spectra are compared, evenly chosen: the preflight takes seconds."""


def examine(
    recording: Recording,
    settings: DoctorSettings | None = None,
    *,
    say: Callable[[str], None] = lambda _: None,
) -> Report:
    """Check units, ranges, signs, sampling, channels, clocks and entries of a recording.

    Nothing is read again: the runs are those of the recording that was loaded.

    Parameters
    ----------
    recording : Recording
        The recording.
    settings : DoctorSettings, optional
        Tolerances.
    say : callable
        Is given the name of each stage.

    Returns
    -------
    Report
        All findings, errors first.

    Raises
    ------
    InvalidData
        If the model was changed since and does not compile.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import numpy as np
    >>> from loose_env.recording import Run, read_recording, write_recording
    >>> xml = '''<mujoco><worldbody><body><joint name="turn" range="-90 90"/><geom size=".1"/>
    ... </body></worldbody><sensor><jointpos name="encoder" joint="turn"/></sensor></mujoco>'''
    >>> time = np.arange(200) / 100
    >>> run = Run(name="a.csv", time=time, sensors={"encoder": 60 * np.cos(time)})  # degrees
    >>> with tempfile.TemporaryDirectory() as place:
    ...     _ = write_recording(Path(place, "swing"), model_xml=xml, runs=[run])
    ...     report = examine(read_recording(Path(place, "swing")))
    >>> [(one.check, one.severity) for one in report.findings]
    [('units', 'error')]
    """
    settings, machine = settings or DoctorSettings(), Machine(recording.model())
    found: list[Finding] = []
    runs: list[Run] = []
    with quiet(), np.errstate(all="ignore"):  # what overflows is not finite, and no finding
        say(f"checking {len(recording.runs)} runs by themselves")
        for whole in recording.runs:
            run, wrong = without_absurd(machine, whole)
            found += [*wrong, *check_sampling(machine, run), *check_channels(machine, run)]
            if 1 / median_step(run.time) <= HIGHEST_RATE_HZ:
                runs.append(run)
        if runs:
            found += _together(machine, without_dead(machine, runs), settings, say)
    seconds = sum(float(run.time[-1] - run.time[0]) for run in recording.runs)
    return Report.of(recording.folder.name, len(recording.runs), seconds, found)


def _together(
    machine: Machine,
    runs: Sequence[Run],
    settings: DoctorSettings,
    say: Callable[[str], None],
) -> Iterator[Finding]:
    """Check all runs against the model and each other, once their positions are put right."""
    say("checking positions, entries and commands")
    turns = list(check_turns(machine, runs))
    yield from turns
    whole = _corrected(runs, turns)
    places = list(confirmed(machine, whole, [*check_positions(machine, whole, settings)]))
    yield from places
    right = _corrected(whole, places)
    yield from check_entries(machine, right, settings)
    yield from check_commands(machine, right, settings)
    say("checking gravity and torques")
    blocks = _motions(machine, right, BLOCK_S)
    yield from check_gravity(machine, blocks, settings)
    changed = list(check_torques(machine, right))
    yield from changed or check_forces(machine, blocks)
    say("checking signs and clocks")
    chosen = np.unique(np.linspace(0, len(right) - 1, MOST_SPECTRA).astype(int))
    motions = _motions(machine, [right[int(k)] for k in chosen])
    yield from check_kinematics(machine, motions)
    yield from check_clocks(machine, motions, settings)


def _corrected(runs: Sequence[Run], found: Sequence[Finding]) -> list[Run]:
    fixes = [each.fix for each in found if each.fix is not None]
    return [corrected(run, fixes) for run in runs]


def _motions(machine: Machine, runs: Sequence[Run], window_s: float = 0.0) -> list[Motion]:
    return [made for run in runs if (made := motion_of(machine, run, window_s)) is not None]
