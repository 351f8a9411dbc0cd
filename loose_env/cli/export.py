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

from __future__ import annotations

import argparse
from pathlib import Path

from loose_env.cli.console import Console, Outcome
from loose_env.cli.options import add_settings, settings_of
from loose_env.cli.output_folder import OutputFolder
from loose_env.errors import InvalidSetting
from loose_env.gap import TARGETS, ExportSettings, export_result, write_export
from loose_env.io import json_text

EXPORTED = "loose-export/1"
"""Format of the JSON document."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this command."""
    parser.add_argument(
        "result", type=Path, metavar="RESULT", help="result.json of 'loose gap', or its folder"
    )
    parser.add_argument("--to", choices=list(TARGETS), required=True, help="target of the export")
    parser.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="folder for what is written"
    )
    parser.add_argument(
        "--urdf", type=Path, metavar="ARM.urdf", help="with --to urdf: URDF to copy and edit"
    )
    add_settings(parser, ExportSettings)


def run(options: argparse.Namespace, console: Console) -> Outcome:
    """Export, and list what the target cannot express."""
    if options.urdf is not None and options.to != "urdf":
        raise InvalidSetting(f"--urdf is for --to urdf; --to {options.to} takes no URDF")
    folder = OutputFolder(options.out, options.command)
    if options.urdf is not None and options.urdf.resolve().parent == folder.path:
        raise InvalidSetting(
            f"--urdf {options.urdf} lies in the output folder, where it would be overwritten; give "
            "another --out"
        )
    settings = settings_of(options, ExportSettings)
    made = export_result(options.result, options.to, settings, urdf=options.urdf)
    folder.note(folder.path / name for name in made.files)
    written = write_export(folder.path, made)
    lines = [f"written: {', '.join(str(path) for path in written)}"]
    if made.not_expressed:
        lines.append(f"not expressed by {options.to}:")
        lines += [f"  {words}" for words in made.not_expressed]
    lines += [f"note: {words}" for words in made.notes]
    return Outcome(
        text="\n".join(lines),
        json=lambda: json_text(
            {
                "format": EXPORTED,
                "target": options.to,
                "files": written,
                "not_expressed": made.not_expressed,
                "notes": made.notes,
            }
        ),
    )
