"""`examine`: all checks of the preflight run on a recording, and the report of findings."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import mujoco
import numpy as np

from loose_env.arms import quiet
from loose_env.doctor.channels import Channel, Factors, Machine, channels_of
from loose_env.doctor.corrections import Correction
from loose_env.doctor.entries import check_entries
from loose_env.doctor.findings import Finding, Report
from loose_env.doctor.model_checks.alternatives import check_alternatives
from loose_env.doctor.model_checks.clocks import check_clocks
from loose_env.doctor.model_checks.encoders import check_encoders
from loose_env.doctor.model_checks.forces import check_forces
from loose_env.doctor.model_checks.gravity import check_gravity
from loose_env.doctor.model_checks.motion import block_motion
from loose_env.doctor.model_checks.positions import check_positions
from loose_env.doctor.quality import check_quality, without_absurd
from loose_env.doctor.sampling import check_rates, check_sampling
from loose_env.doctor.settings import DoctorSettings
from loose_env.doctor.thresholds import HIGHEST_RATE_HZ
from loose_env.importing import median_step
from loose_env.recording import Recording, Run


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
    settings = DoctorSettings() if settings is None else settings
    machine = Machine(recording.model())
    found: list[Finding] = []
    runs: list[tuple[Run, list[Channel]]] = []
    with quiet(), np.errstate(all="ignore"):  # what overflows is not finite, and no finding
        say(f"checking {len(recording.runs)} runs by themselves")
        for whole in recording.runs:
            run, wrong = without_absurd(machine, whole)
            found += wrong
            channels = channels_of(machine, run)
            found += check_sampling(machine, run, channels)
            found += check_quality(machine, run, channels)
            if 1 / median_step(run.time) <= HIGHEST_RATE_HZ:
                runs.append((run, channels))
        if runs:
            found += _together(machine, runs, settings, say)
    seconds = sum(float(run.time[-1] - run.time[0]) for run in recording.runs)
    return Report.of(recording.folder.name, len(recording.runs), seconds, found)


def _together(
    machine: Machine,
    runs: list[tuple[Run, list[Channel]]],
    settings: DoctorSettings,
    say: Callable[[str], None],
) -> Iterator[Finding]:
    """Check all runs against the model and against each other."""
    yield from check_rates([run for run, _ in runs])
    say("checking positions, entries and commands")
    wrong, factors = check_positions(machine, runs, settings)
    encoders = list(check_encoders(machine, runs))
    yield from encoders
    counted = [each for each in encoders if each.check == "units"]
    for each in counted:
        sensor = machine.model.sensor(each.channel.removeprefix("sensor."))
        joint = machine.model.joint(int(sensor.objid[0])).name
        for run, _ in runs:
            if each.run in ("", run.name):
                factors[run.name, joint] = each.fix.factor if each.fix else 1.0
    for each in wrong:
        if not any(c.channel == each.channel and c.run in ("", each.run) for c in counted):
            yield _with_fix(machine, each, factors)
    yield from check_entries(machine, runs, factors, settings)
    if _needs_motion(machine, [run for run, _ in runs]):
        say("checking gravity and torques")
        blocks = []
        for run, channels in runs:
            made = block_motion(machine, run, channels, factors)
            if made is not None:
                blocks.append((run, channels, *made))
        yield from check_gravity(machine, blocks, factors, settings)
        changed = list(check_alternatives(machine, runs, factors))
        yield from changed or check_forces(machine, blocks)
    say("checking signs and clocks")
    yield from check_clocks(machine, runs, factors, settings)


def _with_fix(machine: Machine, finding: Finding, factors: Factors) -> Finding:
    """Finding on a position column with the factor that was found for its joint."""
    model, name = machine.model, finding.channel.removeprefix("sensor.")
    sensor = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, name)
    if name == finding.channel or sensor < 0 or finding.check not in ("units", "sign"):
        return finding
    joint = model.joint(int(model.sensor_objid[sensor])).name
    own = (f for (run, of), f in factors.items() if of == joint and finding.run in ("", run))
    factor = next(own, 1.0)
    if factor == 1.0:
        return finding
    fix = Correction(kind="scale", columns=(finding.channel,), factor=factor)
    return replace(finding, fix=fix.of(finding.run))


def _needs_motion(machine: Machine, runs: Sequence[Run]) -> bool:
    """Return whether any reading depends on the motion through the model."""
    drives = {d.name for d in machine.drives.values() if d.gain}
    return any(
        run.torques or drives & set(run.controls) or any(v.ndim > 1 for v in run.sensors.values())
        for run in runs
    )
