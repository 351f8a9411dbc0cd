"""Diagnosis of a recording (diagnose): posterior over faults, warnings and next measurement."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.instrument.data.dropouts import unbroken
from loose_env.instrument.data.held_pose import RunSetup, run_setup
from loose_env.instrument.data.paired_runs import HeldRun
from loose_env.instrument.data.sensor_selection import columns_in, readings_in
from loose_env.instrument.data.spectral_lines import Lines, lines_of
from loose_env.instrument.inference.findings.correlation_loops import loops_of
from loose_env.instrument.inference.findings.direction_cones import cone, seen_in_tool
from loose_env.instrument.inference.findings.free_travel import Travel, travel_of
from loose_env.instrument.inference.findings.verdict import verdict_of
from loose_env.instrument.inference.findings.warnings import model_warnings, warnings_of
from loose_env.instrument.inference.posterior import ModelComparison, compare_hypotheses
from loose_env.instrument.inference.response.frequency_response import with_leakage
from loose_env.instrument.inference.response.pairing import beside_references
from loose_env.instrument.inference.response.timing import Clocks, clocks_of, servo_timing
from loose_env.instrument.inference.response.uncertain_linear_arm import UncertainArm
from loose_env.instrument.model.instrumented_arm import InstrumentedArm, read_recorded_arm
from loose_env.instrument.planning.plan import next_for
from loose_env.instrument.result import (
    HEALTHY,
    Diagnosis,
    Fault,
    NextMeasurement,
    RecordSeen,
    Severity,
    SlideDirection,
    Vector,
)
from loose_env.instrument.settings.diagnosis import DiagnoseSettings
from loose_env.instrument.settings.motion import MotionSettings
from loose_env.instrument.trend.transmission import spectra_by_fit
from loose_env.recording import Recording, Run, set_aside
from loose_env.version import __version__


@dataclass(frozen=True, kw_only=True, eq=False)
class _Taken:
    """A run and what was made of it."""

    run: Run
    held: RunSetup | None
    lines: Lines | None
    notes: tuple[str, ...]


class Workbench:
    """An arm and its runs, which may become more."""

    def __init__(
        self, model: Path, settings: DiagnoseSettings, motion: MotionSettings | None = None
    ) -> None:
        self.settings = settings
        self.motion = motion
        self.arm = read_recorded_arm(model)
        self.uncertain = UncertainArm(self.arm, settings.tolerances)
        self._taken: list[_Taken] = []
        self._pairs: dict[int, Lines] = {}

    @property
    def runs(self) -> list[Run]:
        """All runs, those that could not be used too."""
        return [taken.run for taken in self._taken]

    @property
    def suspect(self) -> list[Lines]:
        """Lines of the runs under test that can be used."""
        return [t.lines for t in self._taken if t.lines is not None and not t.lines.healthy]

    def add(self, run: Run, *, notes: Sequence[str] = ()) -> None:
        """Take a run up, with notes on it; one that cannot be used is kept with the reason."""
        run, pauses = unbroken(run, columns_in(self.arm, run))
        held = run_setup(self.arm, run)
        # Runs are told apart by their numbers: two may have one name.
        number = sum(taken.lines is not None for taken in self._taken)
        lines = lines_of(self.arm, run, held.pose, held.excited, number=number)
        lines = with_leakage(self.uncertain.at(held.pose), lines)
        notes = (*notes, *pauses, *held.notes, *readings_in(self.arm, run)[1])
        self._taken.append(_Taken(run=run, held=held, lines=lines, notes=notes))

    def leave_out(self, run: Run, why: str) -> None:
        """Keep a run that cannot be used, for the record."""
        self._taken.append(_Taken(run=run, held=None, lines=None, notes=(why,)))

    def diagnosis(
        self, *, plan: bool = True, say: Callable[[str], None] = lambda _: None
    ) -> Diagnosis:
        """Weigh what all runs say together."""
        paired = beside_references(self.uncertain, self._held(), self._pairs)
        clocks = clocks_of(self.uncertain, paired)
        lines = [clocks.corrected(one) for one in paired]
        say(f"weighing {len(self.arm.hypotheses)} hypotheses by {len(lines)} runs")
        comparison = compare_hypotheses(
            self.uncertain, lines, healthy_prior=self.settings.healthy_prior
        )
        best = comparison.best
        travel = None
        if best != HEALTHY and self.suspect:
            say(f"following the seat of {best}")
            travel = travel_of(comparison, best, self._whole(clocks))
        fault = _fault(self.arm, comparison, travel)
        say("following the probabilities from run to run")
        records = self._records(comparison, clocks)
        fit = comparison.fits[best]
        offset = clocks.refined(self.uncertain, fit.errors, fit.normal)
        offsets = () if offset is None else (offset,)
        verdict = verdict_of(comparison, offsets, sure=self.settings.sure)
        notes = [n for t in self._taken for n in t.notes]
        servos = servo_timing(self.uncertain, lines)
        warnings = warnings_of(self.arm, comparison, notes, travel, clocks=offsets, servos=servos)
        found = Diagnosis(
            fault=fault,
            probability=comparison.posterior[best],
            posterior=comparison.posterior,
            warnings=warnings,
            severities=_severities(warnings, model_warnings(comparison), notes),
            records=records,
            model=self.arm.path.name,
            settings=asdict(self.settings),
            directions=_directions(comparison),
            settled=verdict.kind in ("healthy", "faulty"),
            verdict=verdict.kind,
            open_because=verdict.reasons,
            nothing_opened=comparison.nothing_opened,
            misfit=comparison.misfit,
            spectra=spectra_by_fit(self.uncertain, comparison, self._places()),
            version=__version__,
            model_hash=hashlib.sha256(self.arm.path.read_bytes()).hexdigest()[:16],
        )
        if plan and not found.settled:
            say("choosing the next measurement")
            try:
                following = self._next(found)
                said = (*found.warnings, *self._blind())
                found = replace(found, next=following, warnings=said)
            except (InvalidData, InvalidSetting) as error:  # what was found is not lost for it
                found = replace(found, warnings=(*found.warnings, f"nothing next: {error}"))
        return found

    def _held(self) -> list[HeldRun]:
        """Usable runs with their lines."""
        return [
            HeldRun(run=t.run, setup=t.held, lines=t.lines)
            for t in self._taken
            if t.lines is not None and t.held is not None
        ]

    def _places(self) -> dict[int, int]:
        """Number of each run's lines -> its index among the records."""
        used = enumerate(self._taken)
        return {t.lines.number: k for k, t in used if t.lines is not None}

    def _whole(self, clocks: Clocks) -> list[Lines]:
        """All lines of the runs under test, those that were not excited too."""
        found = [self._lines(taken, clocks, whole=True) for taken in self._taken]
        return [lines for lines in found if lines is not None and not lines.healthy]

    def _lines(self, taken: _Taken, clocks: Clocks, *, whole: bool = False) -> Lines | None:
        """Lines of a run on one clock; None of a run that cannot be used."""
        held, lines = taken.held, taken.lines
        if held is None or lines is None:
            return None
        if whole:
            lines = lines_of(
                self.arm, taken.run, held.pose, held.excited, number=lines.number, whole=True
            )
            lines = with_leakage(self.uncertain.at(held.pose), lines)
        return clocks.corrected(lines)

    def _next(self, found: Diagnosis) -> NextMeasurement:
        recorded = 1 / self.suspect[-1].period if self.suspect else None
        return next_for(self.arm, found, self.settings.choice(recorded), motion=self.motion)

    def _blind(self) -> tuple[str, ...]:
        """Warnings about unknown collisions of a chosen pose."""
        look = self.arm.collisions
        lacking = look.unseen if look.known else self.arm.links
        if not lacking:
            return ()
        return (
            f"the next pose was chosen without knowing what {', '.join(lacking)} may touch: the "
            "model has no shapes of them (that of a recording has no meshes). 'loose plan' looks "
            "with the arm's own model; look yourself before the arm moves",
        )

    def _records(self, comparison: ModelComparison, clocks: Clocks) -> tuple[RecordSeen, ...]:
        """Result of each run, with the posterior after it."""
        found: list[RecordSeen] = []
        so_far: list[int] = []
        for taken in self._taken:
            probabilities: dict[str, float] = {}
            direction: Vector | None = None
            angle = None
            lines = self._lines(taken, clocks)
            if lines is not None and not lines.healthy:
                so_far.append(lines.number)
                probabilities = comparison.after(so_far)
                direction, angle = seen_in_tool(self.uncertain, comparison, lines)
            pose = (
                {j: q for j, q in (taken.run.pose or {}).items() if j in self.arm.joints}
                if taken.held is None
                else taken.held.shown(self.arm, taken.run.pose)
            )
            excited = (
                tuple(taken.run.excited)
                if taken.held is None
                else tuple(self.arm.joints[j] for j in taken.held.excited)
            )
            found.append(
                RecordSeen(
                    file=taken.run.name,
                    pose=pose,
                    excited=excited,
                    condition=taken.run.condition,
                    probabilities=probabilities,
                    direction_tool=direction,
                    half_angle_deg=angle,
                    loops=() if lines is None else loops_of(self.uncertain, comparison, lines),
                    notes=taken.notes,
                )
            )
        return tuple(found)


def diagnose(
    recording: Recording,
    settings: DiagnoseSettings | None = None,
    *,
    motion: MotionSettings | None = None,
    plan: bool = True,
    say: Callable[[str], None] = lambda _: None,
) -> Diagnosis:
    """Say what is loose in the arm of a recording.

    Parameters
    ----------
    recording : Recording
        Runs that hold a pose each and shake a joint; healthy reference runs, if there are any.
    settings : DiagnoseSettings, optional
        Prior knowledge.
    motion : MotionSettings, optional
        Limits of the controller that the next measurement keeps to, such as those of the plan
        beside the recording: ``session_beside(recording.folder).limits``. None by default.
    plan : bool
        True to propose the next measurement.
    say : callable
        Told what goes on, line by line.

    Returns
    -------
    Diagnosis

    Raises
    ------
    InvalidData
        If the model is no serial arm, no run can be used, or values overflow.

    Examples
    --------
    >>> from loose_env.recording import read_recording
    >>> diagnose(read_recording("no/recording"))
    Traceback (most recent call last):
        ...
    loose_env.errors.InvalidData: ...
    """
    chosen = DiagnoseSettings() if settings is None else settings
    bench = Workbench(recording.model_path, chosen, motion)
    refused: list[str] = []
    model = recording.model()
    for run in recording.runs:
        try:
            clean, corrupt = set_aside(run, model)
            bench.add(clean, notes=[each.words for each in corrupt])
        except InvalidData as error:
            bench.leave_out(run, str(error))
            refused.append(str(error))
    if not bench.suspect:
        raise InvalidData(
            refused[0]
            if refused
            else "all runs are healthy references; a diagnosis needs a run of the arm under test: "
            'one without "condition": "healthy" in recording.json'
        )
    try:
        found = bench.diagnosis(plan=plan, say=say)
        return replace(found, date=_measured_at(recording))
    except np.linalg.LinAlgError as error:
        raise InvalidData(
            f"model and runs exceed the numeric range ({error}): are masses, gains and readings in "
            "SI units?"
        ) from None


def _measured_at(recording: Recording) -> str:
    """Time of the latest run's file, UTC (ISO 8601); "" where there is none on the disk."""
    files = [recording.folder / run.name for run in recording.runs]
    times = [file.stat().st_mtime for file in files if file.is_file()]
    if not times:
        return ""
    return datetime.fromtimestamp(max(times), tz=UTC).isoformat(timespec="seconds")


def _severities(
    warnings: Sequence[str], of_model: Sequence[str], notes: Sequence[str]
) -> tuple[Severity, ...]:
    """Severity of each warning: those of the model invalidate a result, those on runs are notes."""
    return tuple(
        "critical" if words in of_model else "note" if words in notes else "warning"
        for words in warnings
    )


def _directions(comparison: ModelComparison) -> dict[str, SlideDirection]:
    """Direction of every link's slide, where its own fit has one."""
    found = {}
    for name, fit in comparison.fits.items():
        kind, _, where = name.partition("@")
        if kind != "structural_looseness":
            continue
        axis, half = cone(fit)
        if axis is not None and half is not None:
            found[where] = SlideDirection(axis=axis, half_angle_deg=half)
    return found


def _fault(arm: InstrumentedArm, comparison: ModelComparison, travel: Travel | None) -> Fault:
    best = comparison.best
    if best == HEALTHY:
        return Fault(kind="healthy")
    kind, where = best.split("@", 1)
    fit = comparison.fits[best]
    direction, angle = (None, None) if kind == "backlash" else cone(fit)
    gap = None if travel is None else travel.gap
    return Fault(
        kind="backlash" if kind == "backlash" else "structural_looseness",
        where=where,
        direction=direction,
        direction_half_angle_deg=angle,
        gap_m=gap,
        gap_interval_m=None if travel is None or gap is None else travel.interval,
    )
