"""Commands at a suspect machine: ``loose inspect``, ``loose plan``, ``loose diagnose``."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import OmitArgPrefixes, Positional, arg

from loose_env.cli.command import kept, settled
from loose_env.cli.console import Console, OnRecording, Outcome, Output, OutputFolder
from loose_env.errors import InvalidSetting, MissingExtra
from loose_env.instrument import (
    KEPT,
    PAGE,
    PLAN,
    RECORDING,
    DiagnoseSettings,
    Diagnosis,
    Maintenance,
    ModelSettings,
    MotionSettings,
    NextSettings,
    PlanFiles,
    PlanSettings,
    Trend,
    TrendSettings,
    change_since,
    diagnose,
    inspect_model,
    plan,
    plan_tool,
    read_diagnosis,
    read_maintenance,
    read_recorded_arm,
    read_sessions,
    screen,
    session_beside,
    time_of,
    tool_runs,
    write_plan,
    write_tool_plan,
)
from loose_env.recording import read_recording

_PUT = {
    "run": "put the measured run",
    "repeat": "a repeat of the first run at the end, for drift and scatter,",
    "reference": "the same on the healthy machine",
}
"""Kind of a run -> how it is spoken of."""


@dataclass(frozen=True, kw_only=True)
class Inspect(Output):
    """Predict from the model of an arm alone which faults a diagnosis could find.

    Reads an MJCF or URDF file and prints one screen: the joints with ranges, torque limits and
    drives; the assumed location of the accelerometer; the modes of the held arm; band and level to
    excite each joint with; for every fault whether it is detectable, and the smallest detectable
    free travel.

    Nothing is written unless --json names a file.

        loose inspect arm.xml
        loose inspect arm.urdf --tool flange --payload-kg 1.5 --json -
    """

    model: Positional[Path]
    """MJCF or URDF of the arm."""
    arm: OmitArgPrefixes[ModelSettings]
    """The arm and how it is held."""
    choice: OmitArgPrefixes[Annotated[NextSettings, kept(NextSettings, leave_out=("in_turn",))]]
    """Poses and excitation."""

    def run(self, console: Console) -> Outcome:
        """Inspect the model."""
        found = inspect_model(self.model, settled(self.choice), self.arm)
        return Outcome(text=screen(found), json=found.to_json)


@dataclass(frozen=True, kw_only=True)
class Plan(Output):
    """Plan the next measurement: the pose, the joint to excite and the signal to play.

    Reads the model of an arm (MJCF or URDF) and what is known so far: nothing at first, then the
    result of 'loose diagnose' (--known). Plan, measure and diagnose in turn until the fault is
    identified. By default the plan is what the diagnosis asks for next; with options for poses,
    band, length or rate the pose is chosen anew.

    Written to the output folder: plan.html, what to do at the machine; plan.json, the same for
    programs; signal.csv and signal.parquet, a command for every actuator in its own unit;
    recording, the folder that the measured run goes into and that 'loose diagnose' reads. In the
    folder of an earlier plan the measured runs stay, and settings that are not given hold as
    before.

        loose plan arm.xml --out session
        loose plan arm.xml --out session --known session/diagnosis
    """

    model: Positional[Path]
    """MJCF or URDF of the arm."""
    out: Annotated[Path, arg(metavar="DIR")]
    """Folder for what is written."""
    known: Annotated[Path | None, arg(metavar="RESULT")] = None
    """What is known so far: result.json of 'loose diagnose', or the folder with it."""
    arm: OmitArgPrefixes[Annotated[ModelSettings, kept(ModelSettings)]]
    """The arm and how it is held."""
    choice: OmitArgPrefixes[Annotated[NextSettings, kept(NextSettings)]]
    """Poses and excitation."""
    motion: OmitArgPrefixes[Annotated[MotionSettings, kept(MotionSettings)]]
    """Limits and commands of the controller."""
    own: OmitArgPrefixes[Annotated[PlanSettings, kept(PlanSettings)]]
    """This measurement."""

    def run(self, console: Console) -> Outcome:
        """Plan the next measurement and write it down."""
        from loose_env.report import summary, write_plan_page

        diagnosis = None if self.known is None else read_diagnosis(self.known)
        before, whose = session_beside(self.out / RECORDING), "the earlier plan"
        if self.known is None or diagnosis is None or before.is_newer_than(self.known):
            choice = settled(self.choice, before.choice, whose)
        else:
            choice = settled(self.choice, diagnosis.choice, "the diagnosis")
        arm = settled(self.arm, before.arm, whose)
        motion = settled(self.motion, before.motion, whose)
        own = settled(self.own, before.own, whose, only=KEPT)
        given: dict[str, Any] = {"arm": arm, "choice": choice, "own": own, "motion": motion}
        source = "" if self.known is None else str(self.known)
        if arm.excitation == "joint":
            made = plan(self.model, diagnosis, **given)
            files = PlanFiles(self.out, made.arm.recording_model.xml)
            planned = files.runs_of(made)
            written = write_plan(files, made, known=source)
            text, warnings = summary(made), made.warnings
            page = partial(write_plan_page, files.folder / PAGE, made, planned)
        else:
            struck = plan_tool(self.model, diagnosis, **given)
            files = PlanFiles(self.out, struck.arm.recording_model.xml)
            planned = tool_runs(files, struck)
            written = write_tool_plan(files, struck, known=source)
            text, warnings = summary(struck), struck.warnings
            page = partial(write_plan_page, files.folder / PAGE, struck, planned)
        try:
            written.append(page(folder=self.out, model=self.model))
        except MissingExtra as error:
            warnings = (*warnings, f"no {PAGE}: {error}")
        names = sorted({path.relative_to(files.folder).parts[0] for path in written})
        lines = [text, f"written to {files.folder}: {', '.join(names)}"]
        for kind, words in _PUT.items():
            mine = [str(files.recording / one.file) for one in planned if one.kind == kind]
            if mine:
                lines.append(f"{words} into {', '.join(mine)}")
        return Outcome(
            text="\n".join(lines),
            json=lambda: (files.folder / PLAN).read_text(encoding="utf-8"),
            warnings=warnings,
        )


@dataclass(frozen=True, kw_only=True)
class Diagnose(OnRecording):
    """Diagnose a loose link or a joint with backlash, from runs with excited joints in held poses.

    Reads a recording: a folder with recording.json, the nominal model and measured runs. Runs of
    the healthy arm are optional; they make smaller faults detectable. Computes the probability of a
    healthy arm, of looseness at every link and of backlash at every joint, and proposes the next
    measurement where that does not settle it. Settings of the 'loose plan' in whose folder the
    recording lies hold, unless an option is given here.

    With --before it also says what has changed since earlier sessions of the same arm: the
    transmission of every joint to every tool axis in the same pose and under the same signal, the
    free travel and the probability of a fault, each on a control chart with a stated rate of false
    alarms.

    Written to the output folder: report.html, to be read; result.json, the same for programs and
    for 'loose plan --known'; with --before trend.html and trend.json. With more runs in the
    recording, the same command replaces them.

        loose diagnose session/recording --out session/diagnosis
    """

    out: Annotated[Path, arg(metavar="DIR")]
    """Folder for what is written."""
    ignore_doctor: bool = False
    """Go on although the preflight ('loose doctor') finds errors in the recording."""
    date: Annotated[str | None, arg(metavar="DATE")] = None
    """Date of the measurement, as 2026-05-04 (default: that of the latest run's file)."""
    before: Annotated[tuple[Path, ...], arg(metavar="OLD ...")] = ()
    """Earlier sessions of the same arm: results, session folders or recordings."""
    maintenance: Annotated[Path | None, arg(metavar="FILE")] = None
    """JSON list of {"date", "joint" or "link", "work", "note"}: after it the baseline starts
    anew."""
    trend: OmitArgPrefixes[TrendSettings]
    """Change since earlier sessions."""
    settings: OmitArgPrefixes[Annotated[DiagnoseSettings, kept(DiagnoseSettings)]]
    """Poses and excitation of the next measurement, prior and model errors."""

    def run(self, console: Console) -> Outcome:
        """Diagnose and write it down."""
        from loose_env.cli.recordings import check_first
        from loose_env.report import diagnosis_text, write_diagnosis

        before = session_beside(self.recording)
        settings = settled(self.settings, before.choice, "the plan beside the recording")
        folder = OutputFolder(self.out, "diagnose", reads=self.model)
        if self.recording.resolve() == folder.path:
            raise InvalidSetting("--out is the recording itself; give another folder")
        if self.date is not None:
            time_of(self.date)
        if self.maintenance is not None and not self.before:
            raise InvalidSetting("--maintenance needs earlier sessions; give them by --before")
        recording = read_recording(self.recording, model=self.model)
        arm = read_recorded_arm(recording.model_path)
        records: tuple[Maintenance, ...] = ()
        if self.maintenance is not None:
            records = read_maintenance(self.maintenance, (*arm.joints, *arm.links))
        preflight = check_first(recording, ignore_errors=self.ignore_doctor)
        name = self.recording.resolve().name

        def earlier_diagnosis(place: Path) -> Diagnosis:
            """Diagnosis of the recording of an earlier session, which has no result."""
            console.say(f"diagnosing the earlier session {place}")
            return diagnose(read_recording(place, model=self.model), settings, plan=False)

        trend = None
        with folder.worked_in():
            earlier = read_sessions(self.before, earlier_diagnosis)
            found = diagnose(recording, settings, motion=before.limits, say=console.say)
            found = replace(found, preflight=preflight, date=self.date or found.date)
            if earlier:
                trend = change_since(
                    found, earlier, name=name, maintenance=records, settings=self.trend
                )
        written = write_diagnosis(
            folder.path, found, recording.model_path, recording=name, given=str(self.recording),
            trend=trend, say=console.say,
        )  # fmt: skip
        folder.note(written)
        text = [diagnosis_text(found, arm.shown, folder=str(self.recording), warnings=False)]
        if trend is not None:
            text.append(trend_summary(trend))
        text.append("written: " + ", ".join(str(path) for path in written))
        return Outcome(
            text="\n".join(text),
            json=found.to_json,
            warnings=(*found.warnings, *(trend.warnings if trend else ())),
        )


def trend_summary(trend: Trend) -> str:
    """Change since earlier sessions in a few lines."""
    rate = f"at most {100 * trend.false_alarm_rate:.2g} % of a healthy arm's sessions alarm"
    if not trend.compared:
        return "not compared with earlier sessions: too few are like this one; see the warnings"
    if not trend.changed:
        return f"no change since {len(trend.sessions) - 1} earlier sessions ({rate})"
    lines = [f"changed since earlier sessions ({rate}):"]
    for each in trend.changed[:4]:
        since = trend.sessions[each.alarm or 0]
        what = {
            "probability": "probability of a fault",
            "free_travel": f"free travel of {each.joint}",
            "transmission": f"transmission from {each.joint} to {each.channel}",
        }[each.quantity]
        band = (
            "" if each.band_hz is None else f", {each.band_hz[0]:.0f} to {each.band_hz[1]:.0f} Hz"
        )
        lines.append(f"  {what}{band}: alarm since {since.date[:10] or since.name}")
    return "\n".join(lines)
