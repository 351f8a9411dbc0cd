"""The tool under test, run on one recording: only what is graded, without the page.

This module and `exported`, which simulates the model that is written, are the ones here that import
the tool. They are told where the recording lies and where its result goes, and nothing else.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

from loose_env.gap import GapResult, GapSettings, find_gap, read_result, result_of
from loose_env.recording import read_recording
from scripts.suites.gap.grading.exported import exported_gap

__all__ = ["EXPORTED", "LOG", "RESULT", "Tool", "run_tool"]

Tool = Callable[[Path, Path, float], None]
"""Reads the recording in the first folder and leaves ``result.json`` in the second, told how well
the nominal figures are known."""
RESULT = "result.json"
"""File of a result."""
EXPORTED = "exported.json"
"""File of the gap that the written model leaves in plain MuJoCo, beside that of the fit."""
LOG = "log.txt"
"""File of what the tool said on its way."""


def run_tool(recording: Path, folder: Path, tolerance: float) -> None:
    """Run the tool on one thread and write its result, read back once to see that it is whole.

    Parameters
    ----------
    recording : Path
        Folder of the recording.
    folder : Path
        Folder that exists; `RESULT` and `LOG` are written to it, and `EXPORTED` with the model
        where there is one to be checked; the result last.
    tolerance : float
        Largest relative error of the nominal figures.

    Raises
    ------
    InvalidData
        If the recording cannot be compared, or the result is not of its own format.
    """
    settings = GapSettings(threads=1, tolerance=tolerance)
    with (folder / LOG).open("w", encoding="utf-8", buffering=1) as log:
        found = find_gap(read_recording(recording), settings, say=lambda line: _put(log, line))
    result = result_of(found)
    GapResult.from_json(result.to_json())
    gaps = exported_gap(found, folder)
    if gaps is not None:
        text = json.dumps(dict(zip(("exported", "fit"), gaps, strict=True)))
        (folder / EXPORTED).write_text(text + "\n", encoding="utf-8")
    read_result(result.write(folder / RESULT))


def _put(log: object, line: str) -> None:
    print(line, file=log)  # type: ignore[call-overload]
