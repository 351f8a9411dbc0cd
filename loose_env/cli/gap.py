"""Commands on model errors: ``loose gap`` identifies effects, ``loose export`` exports them."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import OmitArgPrefixes, Positional, UseAppendAction, arg

from loose_env.arms import files_of
from loose_env.cli.command import kept, one_of, settled
from loose_env.cli.console import KEPT, Console, OnRecording, Outcome, Output, OutputFolder
from loose_env.cli.recordings import check_first
from loose_env.errors import InvalidSetting
from loose_env.gap import (
    NEXT_MOTION,
    NO_MOTION,
    TARGETS,
    ExportSettings,
    GapResult,
    GapSettings,
    NextMotionSettings,
    Stages,
    export_result,
    find_gap,
    join_recordings,
    key_of,
    next_motion_lines,
    note_source,
    quick_look,
    read_effects,
    read_next_motion,
    read_source,
    write_export,
    write_gap,
)
from loose_env.io import json_text, write_text
from loose_env.recording import Recording
from loose_env.report import (
    gap_text,
    quick_text,
    require_rerun,
    write_gap_report,
    write_rerun,
)

EXPORTED = "loose-export/1"
"""Format of the JSON document of an export."""
_OWN = ("threads",)
"""Settings on which the result does not depend."""
_KEPT = tuple(each.name for each in fields(GapSettings) if each.name != "held_out")
"""Settings that hold on for an earlier output with further recordings."""


@dataclass(frozen=True, kw_only=True)
class Gap(OnRecording):
    """Identify the effects that a simulation model lacks, and where, from measured runs.

    Reads a recording: a folder with recording.json, the nominal model and two measured runs at
    least. Finds where model and measurement disagree, accepts the effects that improve the
    prediction of held-out runs significantly, and writes the corrected model.

    Written to the output folder: model.xml, the corrected model; report.html, to be read;
    result.json, the same for programs. Finished stages are kept in .gap: after an interruption the
    same command goes on from there.

        loose gap arm --out arm-gap
        loose gap arm --out arm-gap --kinds coulomb_friction backlash
        loose gap arm --out arm-gap --quick

    With --next also the motion that best separates what the runs do not tell apart:
    next_motion.csv and next_motion.parquet, its commands; next_motion.json, what it is expected to
    tell and how it was chosen. Run it on the machine, twice, and give the new recording beside the
    earlier output: the answer is then from all runs.

        loose gap arm --out arm-gap --next
        loose gap arm-gap arm-2 --out arm-gap-2 --next
    """

    more: Positional[tuple[Path, ...]] = ()
    """Further recordings of the same machine, compared together with the first; RECORDING may be
    the output of an earlier run then, whose answer and settings are gone on from."""
    out: Annotated[Path, arg(metavar="DIR")]
    """Folder for what is written."""
    ignore_doctor: bool = False
    """Go on although the preflight ('loose doctor') finds errors in the recording."""
    effects: UseAppendAction[Annotated[tuple[Path, ...], arg(metavar="FILE.py")]] = ()
    """Python file with effects of your own, considered beside the catalogue; it is run."""
    rerun: Annotated[Path | None, arg(metavar="FILE.rrd")] = None
    """Also write measured, nominal and corrected motion of the held-out runs for the Rerun viewer
    (extra rerun); an existing file is replaced."""
    quick: bool = False
    """A look of about half a minute: where the model is wrong and the three most promising
    explanations, without tests and intervals; only quick.json is written."""
    next: bool = False
    """Also write the motion that best separates what these runs do not tell apart."""
    settings: OmitArgPrefixes[Annotated[GapSettings, kept(GapSettings)]]
    """Search, tests and intervals."""
    next_motion: OmitArgPrefixes[Annotated[NextMotionSettings, kept(NextMotionSettings)]]
    """Next motion (--next)."""

    def run(self, console: Console) -> Outcome:
        """Name what the model lacks and write it down."""
        if self.quick and self.next:
            raise InvalidSetting(
                "--quick names nothing, so that there is nothing for --next to separate"
            )
        if self.quick and self.rerun is not None:
            raise InvalidSetting(
                "--quick corrects no model, so that it has no motion for --rerun; leave one of "
                "them out"
            )
        _check_rerun(self.rerun)
        wanted = settled(self.next_motion) if self.next else None
        folder = OutputFolder(self.out, "gap", reads=self.model)
        sources = [
            read_source(path, KEPT, model=self.model) for path in self._recordings(folder.path)
        ]
        earlier = sources[0].result
        before = GapSettings() if earlier is None else _settings_of(earlier)
        settings = settled(self.settings, before, str(self.recording), only=_KEPT)
        recording = sources[0].recording
        if len(sources) > 1:
            recording, held = join_recordings(
                folder.prepared(), sources, share=settings.held_share, held_out=settings.held_out
            )
            settings = replace(settings, held_out=held)
        preflight = check_first(recording, ignore_errors=self.ignore_doctor)
        for file in self.effects:
            read_effects(file)
        if self.quick:
            return _quick(folder, recording, settings, console)
        plain = {k: v for k, v in asdict(settings).items() if k not in _OWN}
        for file in self.effects:
            plain[f"effects of {file}"] = file.read_text(encoding="utf-8")
        if earlier is not None:
            plain["earlier result"] = earlier.to_json()
        with folder.worked_in() as place:
            stages = Stages(place / "stages", key_of(recording, plain))
            note_source(place, recording, self.model)
            found = find_gap(recording, settings, say=console.say, stages=stages, earlier=earlier)
            found = replace(found, preflight=preflight)
        if stages.taken_up:
            console.say(f"resumed from checkpoints: {', '.join(stages.taken_up)}")
        # Known as this command's own even if it is cut short while it copies.
        home = recording.model_path.parent
        folder.note(folder.path / f.relative_to(home) for f in files_of(recording.model_path))
        result, written = write_gap(
            folder.path, found, report=partial(write_gap_report, say=console.say), say=console.say,
            next_motion=wanted, earlier=earlier,
        )  # fmt: skip
        if self.rerun is not None:
            console.say("writing the motion for Rerun")
            file = write_rerun(self.rerun.resolve(), found)
            written = [*written, file] if file.is_relative_to(folder.path) else written
        folder.note(written)
        shown = [str(path) for path in written if path.parent == folder.path]
        if self.rerun is not None and str(self.rerun.resolve()) not in shown:
            shown.append(str(self.rerun))
        motion = _next(folder.path, result) if self.next else []
        lines = [gap_text(result, warnings=False), *motion, f"written: {', '.join(shown)}"]
        return Outcome(text="\n".join(lines), json=result.to_json, warnings=tuple(result.warnings))

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


def _settings_of(result: GapResult) -> GapSettings:
    """Settings of an earlier result; the defaults for those that it does not have."""
    known = {each.name for each in fields(GapSettings)}
    given: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value
        for name, value in result.settings.items()
        if name in known and name != "held_out"
    }
    return GapSettings(**given)


def _next(folder: Path, result: GapResult) -> list[str]:
    """Lines on the next motion."""
    file = folder / f"{NEXT_MOTION}.json"
    if not file.is_file():
        if any(words.startswith(NO_MOTION) for words in result.warnings):
            return ["next motion: none, for the reason in the warnings"]
        return ["next motion: none; nothing is left that a motion would tell apart"]
    return next_motion_lines(read_next_motion(file))


def _quick(
    folder: OutputFolder, recording: Recording, settings: GapSettings, console: Console
) -> Outcome:
    """Rank what may be missing, from windows of the runs."""
    with folder.worked_in():
        look = quick_look(recording, settings, say=console.say)
        file = write_text(folder.path / "quick.json", look.to_json())
    folder.note([file])
    return Outcome(
        text=f"{quick_text(look)}\nwritten: {file}", json=look.to_json, warnings=look.warnings
    )


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
      bam       bam_JOINT.json: parameters of BAM (Better Actuator Models) for each servo
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
