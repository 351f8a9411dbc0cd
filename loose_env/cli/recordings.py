"""Command that makes recordings: ``loose import``."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NoReturn

import mujoco
from tyro.conf import OmitArgPrefixes, Positional, arg

from loose_env.cli.command import refuse
from loose_env.cli.console import Console, Outcome, Output
from loose_env.errors import InvalidData, InvalidSetting
from loose_env.importing import (
    ImportSettings,
    Proposal,
    import_recording,
    proposal_text,
    propose,
)
from loose_env.io import json_text, write_text
from loose_env.recording import Recording, load_model

IMPORTED, PROPOSAL = "loose-import/1", "loose-proposal/1"
"""Formats of the JSON documents of an import, and of --guess."""
PROPOSED = "mapping.toml"
"""File that --guess writes where --mapping names none."""


@dataclass(frozen=True, kw_only=True)
class Import(Output):
    """Make a recording from logs: ROS bags, tables, LeRobot datasets, files of arrays.

    A mapping file says which channel of which file goes into which column of the recording, in
    which unit, and by which clock. --guess proposes one by names, ranges and correlations, with the
    reason for each line and every other channel as a comment, and writes it for you to check.

        loose import --guess robot.mcap --model arm.xml --mapping mapping.toml
        loose import robot.mcap --mapping mapping.toml --out recording
        loose import robot-*.csv acc-*.csv --mapping mapping.toml --out session/recording

    Into the recording of 'loose plan' go the runs that the mapping calls by the plan's names; its
    model, poses and conditions stay. Any other recording is read back and checked before it takes
    its final name: a folder of that name is always complete.
    """

    sources: Positional[
        Annotated[tuple[str, ...], arg(metavar="SOURCE ...", help_behavior_hint="(required)")]
    ] = ()
    """File or folder of a log; NAME=PATH where the mapping calls it NAME."""
    guess: bool = False
    """Propose the mapping for --model, print it and write it to --mapping (mapping.toml by
    default)."""
    rate_hz: float | None = None
    """With --guess: sampling rate of files without times [Hz]."""
    mapping: Annotated[Path | None, arg(metavar="MAP")] = None
    """Mapping file, TOML."""
    out: Annotated[Path | None, arg(metavar="RECORDING")] = None
    """Folder of the recording; a new one, or that of a plan."""
    model: Annotated[Path | None, arg(metavar="MODEL.xml")] = None
    """MJCF file in the place of the mapping's."""
    package_path: Annotated[Path | None, arg(metavar="DIR")] = None
    """With --guess: folder of the package, or packages, of a URDF's meshes."""
    settings: OmitArgPrefixes[ImportSettings]
    """The recording that is written."""

    def run(self, console: Console) -> Outcome:
        """Import, or propose a mapping."""
        if not self.sources:
            _refuse("SOURCE must be given")
        if self.guess:
            return self._guessed(console)
        if self.rate_hz is not None:
            _refuse("--rate-hz is for --guess; a mapping has time = { rate_hz = ... }")
        if self.mapping is None or self.out is None:
            _refuse("give --mapping MAP and --out RECORDING, or --guess")
        recording = import_recording(
            self.sources, self.mapping, self.out, self.settings, model=self.model, say=console.say
        )
        count = len(recording.runs)
        return Outcome(
            text=f"written: {self.out} ({count} run{'s' * (count != 1)})",
            json=lambda: json_text({"format": IMPORTED, **contents(recording)}),
        )

    def _guessed(self, console: Console) -> Outcome:
        """Proposed mapping, written to a file and as JSON."""
        if self.model is None or self.out is not None:
            _refuse("--guess takes files, --model and the --mapping to write, no --out")
        if self.rate_hz is not None and not 1e-6 <= self.rate_hz <= 1e9:
            raise InvalidSetting(f"--rate-hz is from 1e-6 to 1e9 Hz, got {self.rate_hz:g}")
        target = self.mapping or Path(PROPOSED)
        if target.suffix.lower() != ".toml":
            raise InvalidSetting(f"--mapping {str(target)!r}: a proposal is written as .toml")
        if target.exists() and not self.settings.overwrite:
            raise InvalidSetting(
                f"{str(target)!r} is there already; --overwrite replaces it, or name another file "
                "by --mapping"
            )
        proposal = propose(self.sources, self._compiled(self.model), self.rate_hz)
        way = os.path.relpath(self.model.resolve(), target.resolve().parent)
        text = proposal_text(proposal, Path(way).as_posix())
        write_text(target, text)
        if proposal.refused:
            raise InvalidData(f"{proposal.refused}; {target} lists all channels")
        taken = [each for each in proposal.columns if not each.open]
        console.say(f"written: {target}, {len(taken)} columns; check each line before the import")
        return Outcome(
            text=text,
            json=lambda: json_text({"format": PROPOSAL, **proposed(proposal, target)}),
        )

    def _compiled(self, model: Path) -> mujoco.MjModel:
        if not model.is_file():
            raise InvalidSetting(f"there is no model {str(model)!r}")
        return load_model(model, package=self.package_path)[1]


def _refuse(words: str) -> NoReturn:
    refuse("loose import", words)


def proposed(proposal: Proposal, target: Path) -> dict[str, Any]:
    """Lines of a proposal, each with its reason."""
    columns = [
        {
            "column": each.column or None,
            "source": each.candidate.source,
            "topic": each.candidate.key.topic or None,
            "channel": each.candidate.key.channel,
            "unit": each.scaling.unit or None,
            "scale": each.scaling.scale,
            "sign": each.scaling.sign,
            "offset": each.scaling.offset,
            "complete": not each.open,
            "reason": each.reason,
        }
        for each in proposal.columns
    ]
    return {"mapping": target, "columns": columns, "notes": list(proposal.notes)}


def contents(recording: Recording) -> dict[str, Any]:
    """Contents of a recording: its model, and every run with its columns, length and rate."""
    runs = []
    for run in recording.runs:
        seconds = float(run.time[-1] - run.time[0])
        runs.append(
            {
                "file": run.name,
                "samples": len(run.time),
                "seconds": seconds,
                "rate_hz": (len(run.time) - 1) / seconds if seconds > 0 else None,
                "condition": run.condition,
                "excited": list(run.excited),
                "controls": list(run.controls),
                "sensors": list(run.sensors),
                "torques": list(run.torques),
            }
        )
    return {"recording": recording.folder, "model": recording.model_path, "runs": runs}
