"""Commands at a suspect machine: ``loose inspect``, ``plan``, ``diagnose`` and ``trend``."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from tyro.conf import OmitArgPrefixes, Positional, arg

from loose_env.cli.command import kept, settled
from loose_env.cli.console import Console, OnRecording, Outcome, Output, OutputFolder
from loose_env.errors import InvalidSetting, MissingExtra
from loose_env.importing import drives_of, followers
from loose_env.instrument import (
    PLAN,
    RECORDING,
    DiagnoseSettings,
    PlanSettings,
    diagnose,
    next_number,
    plan,
    read_diagnosis,
    read_plan,
    swept,
    trend,
    write_plan,
)
from loose_env.recording import read_recording

PAGE = "plan.html"


@dataclass(frozen=True, kw_only=True)
class Inspect(Output):
    """Say from the model of an arm alone what a session could test.

    Reads an MJCF or URDF file, chooses poses as 'loose plan' does, and prints one screen: joints,
    links, limits, the signal, for every link and joint whether its load would reverse, and each
    drive by its force law. Nothing is written unless --json names a file.

        loose inspect arm.xml --controller ur_rtde
        loose inspect arm.urdf --tool flange --payload-kg 1.5 --json -
    """

    model: Positional[Path]
    """MJCF or URDF of the arm."""
    settings: OmitArgPrefixes[PlanSettings]
    """Controller, limits and poses."""

    def run(self, console: Console) -> Outcome:
        """Inspect the model."""
        from loose_env.report import summary

        made, arm = plan(self.model, self.settings)
        words = [f"drive {each.words}" for each in drives_of(arm.model)] + followers(arm.model)
        text = "\n".join([summary(made), *words])
        return Outcome(text=text, json=made.to_json, warnings=made.notes)


@dataclass(frozen=True, kw_only=True)
class Plan(Output):
    """Plan a session: the poses to shake the arm in, and the commands to play.

    Reads the model of an arm (MJCF or URDF). With --known, the result of 'loose diagnose', the
    poses test what was not tested yet, or tell the places that are still suspect apart.

    Written to the output folder: plan.html, what to do at the machine; plan.json, the same for
    programs; run-01.csv and so on, the commands; recording, the folder that the measured runs go
    into and that 'loose diagnose' reads. In the folder of an earlier plan the measured runs stay,
    and settings that are not given hold as before.

    The first run is sweep.csv. Once recording/sweep.csv is there, plan once more: its 5 s have
    measured how far the joints follow, and all runs are written for that. No sweep is planned where
    --bandwidth-hz is stated, or for torques.

        loose plan arm.xml --controller ur_rtde --out session
        loose plan arm.xml --out session
        loose plan arm.xml --out session --known session/diagnosis
        loose plan arm.xml --out session-after --like session
    """

    model: Positional[Path]
    """MJCF or URDF of the arm."""
    out: Annotated[Path, arg(metavar="DIR")]
    """Folder for what is written."""
    known: Annotated[Path | None, arg(metavar="RESULT")] = None
    """What is known so far: result.json of 'loose diagnose', or the folder with it."""
    like: Annotated[Path | None, arg(metavar="SESSION")] = None
    """Session whose settings, and so poses and commands, are taken: after a repair, or on the
    healthy day."""
    settings: OmitArgPrefixes[Annotated[PlanSettings, kept(PlanSettings)]]
    """Controller, limits and poses."""

    def run(self, console: Console) -> Outcome:
        """Plan the session and write it down."""
        from loose_env.report import summary, write_plan_page

        known = None if self.known is None else read_diagnosis(self.known)
        there = self.out / PLAN
        if self.like is not None and there.is_file():
            raise InvalidSetting(
                f"--like is for a new folder: {there} has settings of its own, which hold as before"
            )
        place = self.out if there.is_file() else self.like
        before = None if place is None else read_plan(place).settings
        own = settled(self.settings, before, "the earlier plan")
        if self.out.exists() and not self.out.is_dir():
            raise InvalidSetting(f"--out {self.out} is a file; give a folder")
        found = None if own.bandwidth_hz else swept(self.out)
        if found is not None:
            own = replace(own, bandwidth_hz=found[0])
        made, arm = plan(self.model, own, known=known, first=next_number(self.out))
        if found is not None:
            made = replace(made, notes=(found[1], *made.notes))
        written = write_plan(self.out, made, arm)
        warnings = made.notes
        try:
            page = write_plan_page(self.out / PAGE, made, folder=self.out, model=self.model)
            written.append(page)
        except MissingExtra as error:
            warnings = (*warnings, f"no {PAGE}: {error}")
        names = sorted({path.relative_to(self.out).parts[0] for path in written})
        lines = [summary(made), f"written to {self.out}: {', '.join(names)}"]
        for condition, words in (
            ("suspect", "put the measured runs"),
            ("healthy", "the same on the healthy machine"),
        ):
            files = [r.file for r in made.runs if r.condition == condition]
            if files:
                place = self.out / RECORDING
                lines.append(f"{words} into {place}: {files[0]} to {files[-1]}")
        return Outcome(text="\n".join(lines), json=made.to_json, warnings=warnings)


@dataclass(frozen=True, kw_only=True)
class Diagnose(OnRecording):
    """Say which link is loose or which joint has play, from the runs of a plan.

    Reads a recording: a folder with recording.json, the nominal model and the measured runs of
    'loose plan'. Healthy runs of the same plan are optional; with them smaller faults are found,
    and play is told from a loose seat. Every link and joint is called loose, suspect, tight or not
    tested.

    Written to the output folder: report.html, to be read; result.json, the same for programs and
    for 'loose plan --known'. With more runs in the recording, the same command replaces them.

        loose diagnose session/recording --out session/diagnosis
    """

    out: Annotated[Path, arg(metavar="DIR")]
    """Folder for what is written."""
    healthy: Annotated[Path | None, arg(metavar="RECORDING")] = None
    """Recording of the same plan on the healthy machine, of another day."""
    ignore_doctor: bool = False
    """Go on although the preflight ('loose doctor') finds errors in the recording."""
    settings: OmitArgPrefixes[DiagnoseSettings]
    """What is asked for."""

    def run(self, console: Console) -> Outcome:
        """Diagnose and write it down."""
        from loose_env.cli.doctor import check_first
        from loose_env.report import diagnosis_text, write_diagnosis

        folder = OutputFolder(self.out, "diagnose", reads=self.model)
        if self.recording.resolve() == folder.path:
            raise InvalidSetting("--out is the recording itself; give another folder")
        recording = read_recording(self.recording, model=self.model)
        preflight = check_first(recording, ignore_errors=self.ignore_doctor)
        if self.healthy is not None:
            there = read_recording(self.healthy, model=recording.model_path).runs
            added = [
                replace(run, condition="healthy", name=f"{self.healthy.name}/{run.name}")
                for run in there
            ]
            recording = replace(recording, runs=(*recording.runs, *added))
        with folder.worked_in():
            found = diagnose(recording, self.settings, say=console.say)
            found = replace(found, preflight=preflight)
        name = self.recording.resolve().name
        given, model = str(self.recording), recording.model_path
        written = write_diagnosis(
            folder.path, found, model, recording=name, given=given, say=console.say
        )
        folder.note(written)
        text = [diagnosis_text(found, folder=str(self.recording))]
        text.append("written: " + ", ".join(str(path) for path in written))
        return Outcome(text="\n".join(text), json=found.to_json)


@dataclass(frozen=True, kw_only=True)
class Trend(Output):
    """Compare sessions of the same plan, month by month: what changed, and since when.

    Reads recordings of one plan, oldest first. Each is compared with the first; from the fourth on
    the scatter of the first three widens the limits where it is larger.

    Written to the output folder: trend.html, trend.json.

        loose trend 2026-05/recording 2026-06/recording 2026-07/recording --out trend
    """

    sessions: Positional[tuple[Path, ...]]
    """Recordings, oldest first."""
    out: Annotated[Path, arg(metavar="DIR")]
    """Folder for what is written."""

    def run(self, console: Console) -> Outcome:
        """Compare the sessions and write it down."""
        from loose_env.report import trend_text, write_trend_page

        folder = OutputFolder(self.out, "trend")
        names = [
            str(path.parent.name if path.name == RECORDING else path.name)
            for path in (place.resolve() for place in self.sessions)
        ]
        with folder.worked_in():
            recordings = [read_recording(place) for place in self.sessions]
            found = trend(recordings, names, say=console.say)
        written = [found.write(folder.path / "trend.json")]
        warnings: tuple[str, ...] = ()
        try:
            written.append(write_trend_page(folder.path / "trend.html", found))
        except MissingExtra as error:
            warnings = (f"no trend.html: {error}",)
        folder.note(written)
        text = [trend_text(found), "written: " + ", ".join(str(path) for path in written)]
        return Outcome(text="\n".join(text), json=found.to_json, warnings=warnings)
