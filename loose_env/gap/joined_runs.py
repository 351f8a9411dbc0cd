"""Recordings of one machine joined as one, those of earlier outputs included."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from loose_env.errors import InvalidData
from loose_env.gap.output.result import read_result
from loose_env.io import json_text, restored, whole_of, write_text
from loose_env.recording import Recording, Run, read_recording, write_recording

_NOTE = "source.json"
"""File in the folder of an output that says which recording a result is of."""
_FORMAT = "loose-gap-source/1"
_JOINED = "recording"
"""Folder there with the runs of several recordings."""


@dataclass(frozen=True)
class _Source:
    """Recording of a result, and the model that took the place of its own."""

    recording: str
    model: str | None = None


def read_source(path: Path, kept: str, *, model: Path | None = None) -> Recording:
    """Read a recording, or that of the output of an earlier comparison.

    Parameters
    ----------
    path : Path
        Folder of a recording, or of an earlier output.
    kept : str
        Name of the folder in an output for what is kept between runs.
    model : Path, optional
        MJCF file that takes the place of the recording's model.

    Raises
    ------
    InvalidData
        If it is neither, or the recording of an output is gone.
    """
    note = path / kept / _NOTE
    if not (path / "result.json").is_file() or (path / "recording.json").exists():
        if path.is_file() and path.suffix == ".xml":
            raise InvalidData(f"{path} is a model and no recording; give it as --model {path}")
        return read_recording(path, model=model)
    read_result(path)
    if not note.is_file():
        raise InvalidData(
            f"{path} holds a result and does not say of which recording (it is of an earlier "
            "version); give the recording in its place"
        )
    whole = whole_of(note.read_text(encoding="utf-8"), format=_FORMAT, noun="note of the recording")
    source = restored(_Source, whole, str(note))
    place = (note.parent / source.recording).resolve()
    if not place.is_dir():
        raise InvalidData(
            f"{path} is the result of the recording {place}, which is gone; give the recording "
            "from where it is now"
        )
    if model is None and source.model is not None:
        model = Path(source.model)
    return read_recording(place, model=model)


def note_source(kept: Path, recording: Recording, model: Path | None) -> None:
    """Note in a folder of checkpoints which recording a result is of."""
    folder = recording.folder
    shown = folder.name if folder.parent == kept.resolve() else str(folder)
    source = _Source(shown, None if model is None else str(model.resolve()))
    write_text(kept / _NOTE, json_text({"format": _FORMAT, **asdict(source)}))


def join_recordings(kept: Path, recordings: Sequence[Recording]) -> Recording:
    """Write the runs of several recordings of one machine as one.

    Parameters
    ----------
    kept : Path
        Folder in which the recording is written.
    recordings : sequence of Recording
        The recordings, the one that came first before the others.

    Returns
    -------
    Recording
        All runs, with the model of the first recording; the names of further ones begin with
        ``next2``, ``next3``, and so on.

    Raises
    ------
    InvalidData
        If the models of two recordings differ.
    """
    first = recordings[0]
    text = first.spec().to_xml()
    runs: list[Run] = list(first.runs)
    for number, own in enumerate(recordings[1:], start=2):
        if own.spec().to_xml() != text:
            raise InvalidData(
                f"the models of {first.folder} and {own.folder} differ; several recordings are "
                "compared with one model: give it as --model"
            )
        stem = f"next{number}"
        while any(run.name.startswith(f"{stem}-") for run in runs):
            stem += "a"
        runs += [replace(run, name=f"{stem}-{run.name}") for run in own.runs]
    folder = kept / _JOINED
    return write_recording(
        folder, model_xml=first.model_path, runs=runs, file_format="parquet",
        overwrite=folder.exists(),
    )  # fmt: skip
