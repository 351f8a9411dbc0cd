"""Commands on model errors: ``loose gap`` identifies effects, ``loose export`` exports them."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Annotated

from tyro.conf import OmitArgPrefixes, Positional, UseAppendAction, arg

from loose_env.arms import files_of
from loose_env.cli.command import kept, one_of, option_words, refuse, settled
from loose_env.cli.console import KEPT, Console, OnRecording, Outcome, Output, OutputFolder
from loose_env.cli.doctor import check_first
from loose_env.errors import InvalidData, InvalidSetting, UnknownName
from loose_env.gap import (
    TARGETS,
    ExportSettings,
    GapSettings,
    GapSolution,
    NextMotion,
    NextMotionSettings,
    check_gap,
    choose_next,
    effect_class,
    export_result,
    join_recordings,
    next_motion_lines,
    note_source,
    read_effects,
    read_source,
    solve_gap,
    split_held_out,
    write_export,
    write_gap,
)
from loose_env.io import json_text
from loose_env.recording import Run
from loose_env.report import (
    check_text,
    gap_text,
    require_rerun,
    write_gap_report,
    write_rerun,
)

CHECKED = "loose-gap-check/1"
"""Format of the JSON document of ``--check``."""
EXPORTED = "loose-export/1"
"""Format of the JSON document of an export."""


@dataclass(frozen=True, kw_only=True)
class Gap(GapSettings, OnRecording):
    """Identify the effects that a simulation model lacks, and where, from measured runs.

    Reads a recording: a folder with recording.json, the nominal model and measured runs. Asks
    which force was missing along the measured motion, names the effects that held-out data
    confirm, and writes the corrected model.

    Written to the output folder: model.xml, the corrected model; report.html, to be read;
    result.json, the same for programs.

        loose gap arm --out arm-gap
        loose gap arm --out arm-gap --kinds coulomb_friction joint_compliance
        loose gap arm --out arm-gap --tolerances.mass 0.02

    With --check nothing is named: it prints what the recording could show, which joints it moves
    and from what size each effect would be seen, before more is recorded.

        loose gap arm --check

    Further recordings of the same machine are analysed together with the first, which may be the
    output of an earlier run.

        loose gap arm-gap arm-2 --out arm-gap-2

    With --next also the motion that best separates what the runs do not tell apart:
    next_motion.csv and next_motion.parquet, its commands; next_motion.json, what it is expected to
    tell and how it was chosen. Run it on the machine, twice, and analyse both together.

        loose gap arm --out arm-gap --next
    """

    more: Positional[tuple[Path, ...]] = ()
    """Further recordings of the same machine, analysed together with the first; RECORDING may be
    the output of an earlier run."""
    out: Annotated[Path | None, arg(metavar="DIR")] = None
    """Folder for what is written; not needed with --check."""
    check: bool = False
    """Print what the recording could show, and stop before any effect is selected."""
    ignore_doctor: bool = False
    """Go on although the preflight ('loose doctor') finds errors in the recording."""
    effects: UseAppendAction[Annotated[tuple[Path, ...], arg(metavar="FILE.py")]] = ()
    """Python file with effects of your own, considered beside the catalogue; it is run."""
    rerun: Annotated[Path | None, arg(metavar="FILE.rrd")] = None
    """Also write measured, nominal and corrected motion for the Rerun viewer (extra rerun); an
    existing file is replaced."""
    next: bool = False
    """Also write the motion that best separates what these runs do not tell apart."""
    next_motion: OmitArgPrefixes[Annotated[NextMotionSettings, kept(NextMotionSettings)]]
    """Next motion (--next)."""

    def run(self, console: Console) -> Outcome:
        """Name what the model lacks and write it down."""
        if self.check:
            return self._checked(console)
        if self.out is None:
            refuse("loose gap", "--out DIR must be given, or --check")
        _check_rerun(self.rerun)
        settings, wanted = self._settings(), settled(self.next_motion)
        folder = OutputFolder(self.out, "gap", reads=self.model)
        sources = [
            read_source(path, KEPT, model=self.model) for path in self._recordings(folder.path)
        ]
        with folder.worked_in() as place:
            recording = sources[0] if len(sources) == 1 else join_recordings(place, sources)
            split_held_out(recording, settings)  # refuses unknown runs before the preflight
            preflight = check_first(recording, ignore_errors=self.ignore_doctor)
            found = solve_gap(recording, settings, preflight=preflight, say=console.say)
            motion, planned = None, list[str]()
            if self.next:
                found, motion, planned = _next(found, wanted, console)
            note_source(place, recording, self.model)
        # Known as this command's own even if it is cut short while it copies.
        home = recording.model_path.parent
        folder.note(folder.path / f.relative_to(home) for f in files_of(recording.model_path))
        page = partial(write_gap_report, say=console.say)
        written = write_gap(folder.path, found, report=page, next_motion=motion, say=console.say)
        if self.rerun is not None:
            console.say("writing the motion for Rerun")
            file = write_rerun(self.rerun.resolve(), found)
            written = [*written, file] if file.is_relative_to(folder.path) else written
        folder.note(written)
        shown = [str(path) for path in written if path.parent == folder.path]
        if self.rerun is not None and str(self.rerun.resolve()) not in shown:
            shown.append(str(self.rerun))
        result = found.result
        lines = [gap_text(result, warnings=False), *planned, f"written: {', '.join(shown)}"]
        return Outcome(text="\n".join(lines), json=result.to_json, warnings=result.warnings)

    def _settings(self) -> GapSettings:
        """Settings of the comparison alone, with the kinds of effect that files register."""
        for file in self.effects:
            read_effects(file)
        try:
            for kind in self.kinds:
                effect_class(kind)  # refuses an unknown one before anything is read
        except UnknownName as error:
            raise InvalidSetting(f"--kinds: {error}") from None
        return GapSettings(**{each.name: getattr(self, each.name) for each in fields(GapSettings)})

    def _checked(self, console: Console) -> Outcome:
        """Say what the recordings could show."""
        idle = ("out", "rerun", "next", "held_out")
        if given := [name for name in idle if getattr(self, name)]:
            words = option_words(dict.fromkeys(given, True)).strip()
            raise InvalidSetting(f"--check writes and holds out nothing; leave out {words}")
        if self.more:
            raise InvalidSetting("--check looks at one recording; leave out the others")
        settings = self._settings()
        recording = read_source(self.recording, KEPT, model=self.model)
        check_first(recording, ignore_errors=self.ignore_doctor)
        found = check_gap(recording, settings, say=console.say)
        return Outcome(
            text=check_text(found), json=lambda: json_text({"format": CHECKED, **asdict(found)})
        )

    def _recordings(self, out: Path) -> list[Path]:
        """Recordings of the command line, none of them twice or in the output folder."""
        paths = [self.recording, *self.more]
        places = [path.resolve() for path in paths]
        for k, (path, place) in enumerate(zip(paths, places, strict=True)):
            if place in places[:k]:
                raise InvalidSetting(f"{path} is given twice; give each recording once")
            if place == out:
                raise InvalidSetting(
                    f"--out {self.out} is {path} itself, which would be overwritten; give another "
                    "folder"
                )
            if k and path.is_file():
                raise InvalidSetting(
                    f"{path} is a file; further recordings are folders, and a model is --model "
                    f"{path}"
                )
        return paths


def _next(
    found: GapSolution, settings: NextMotionSettings, console: Console
) -> tuple[GapSolution, tuple[NextMotion, Run] | None, list[str]]:
    """Choose the next motion, and say why there is none; the result does not depend on it."""
    try:
        motion = choose_next(found.answer, found.corrected, settings, say=console.say)
    except InvalidData as error:
        words = (*found.result.warnings, f"no next motion: {error}")
        found = replace(found, result=replace(found.result, warnings=words))
        return found, None, ["next motion: none, for the reason in the warnings"]
    if motion is None:
        return found, None, ["next motion: none; nothing is left that a motion would tell"]
    return found, motion, next_motion_lines(motion[0])


def _check_rerun(file: Path | None) -> None:
    """Refuse a file of Rerun that cannot be written, before the search."""
    if file is None:
        return
    if file.suffix != ".rrd" or file.is_dir():
        raise InvalidSetting(f"--rerun {file}: give the name of a file that ends with .rrd")
    require_rerun()


@dataclass(frozen=True, kw_only=True)
class Export(Output):
    """Export the effects that 'loose gap' identified to other simulators, tools and trainers.

    Reads result.json and model.xml of 'loose gap'. Targets, with the files written:
      sysid     parameters.py, parameters.yaml: a ParameterDict of mujoco.sysid
      mjlab     mjlab_actuators.py: actuator configurations
      isaaclab  isaaclab_actuators.py: actuator configurations
      urdf      copy of --urdf with <dynamics> tags, or dynamics.urdf.xml to paste from
      usd       joints.usda: layer with the attributes of drives and joints
      bam       bam_JOINT.json: parameters of BAM (Better Actuator Models) for each servo
      drivebam  drivebam_actuators.py: the same as Isaac Lab's DriveBam of Newton
      ranges    ranges.json: ranges for domain randomisation, from 95 % intervals

    Effects that a target cannot express are listed, in its files and on the standard output.

        loose export arm-gap --to isaaclab --out exports --timestep 0.005
        loose export arm-gap --to urdf --out exports --urdf arm.urdf
    """

    result: Positional[Path]
    """File result.json of 'loose gap', or its folder."""
    to: Annotated[str, one_of(tuple(TARGETS))]
    """Target of the export."""
    out: Annotated[Path, arg(metavar="DIR")]
    """Folder for what is written."""
    urdf: Annotated[Path | None, arg(metavar="ARM.urdf")] = None
    """With --to urdf: URDF to copy and edit."""
    settings: OmitArgPrefixes[ExportSettings]
    """The target's own."""

    def run(self, console: Console) -> Outcome:
        """Export, and list what the target cannot express."""
        if self.urdf is not None and self.to != "urdf":
            raise InvalidSetting(f"--urdf is for --to urdf; --to {self.to} takes no URDF")
        folder = OutputFolder(self.out, "export")
        if self.urdf is not None and self.urdf.resolve().parent == folder.path:
            raise InvalidSetting(
                f"--urdf {self.urdf} lies in the output folder, where it would be overwritten; "
                "give another --out"
            )
        made = export_result(self.result, self.to, self.settings, urdf=self.urdf)
        folder.note(folder.path / name for name in made.files)
        written = write_export(folder.path, made)
        lines = [f"written: {', '.join(str(path) for path in written)}"]
        if made.not_expressed:
            lines.append(f"not expressed by {self.to}:")
            lines += [f"  {words}" for words in made.not_expressed]
        lines += [f"note: {words}" for words in made.notes]
        document = {
            "format": EXPORTED,
            "target": self.to,
            "files": written,
            "not_expressed": made.not_expressed,
            "notes": made.notes,
        }
        return Outcome(text="\n".join(lines), json=lambda: json_text(document))
