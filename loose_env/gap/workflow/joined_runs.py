"""Recordings of one machine joined as one, beside the result of the first where there is one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

from loose_env.errors import InvalidData
from loose_env.gap.data.holdout_split import split_runs
from loose_env.gap.output.result import GapResult, read_result
from loose_env.io import json_text, whole_of, write_text
from loose_env.recording import Recording, Run, read_recording, write_recording

_NOTE = "source.json"
"""File in the folder of checkpoints that says which recording a result is of."""
_FORMAT = "loose-gap-source/1"
_JOINED = "recording"
"""Folder there with the runs of several recordings."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Source:
    """A recording to compare, and what is known from it already."""

    recording: Recording
    """Its runs."""
    result: GapResult | None = None
    """The result, where the source is the output of an earlier comparison."""


def read_source(path: Path, kept: str, *, model: Path | None = None) -> Source:
    """Read a recording, or the recording and result of the output of an earlier comparison.

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
        return Source(recording=read_recording(path, model=model))
    result = read_result(path)
    if not note.is_file():
        raise InvalidData(
            f"{path} holds a result and does not say of which recording (it is of an earlier "
            "version); give the recording in its place"
        )
    whole = whole_of(note.read_text(encoding="utf-8"), format=_FORMAT, noun="note of the recording")
    folder = whole.get("recording")
    if not isinstance(folder, str):
        raise InvalidData(f"{note}: recording is a path; run the comparison again")
    place = (note.parent / folder).resolve()
    if not place.is_dir():
        raise InvalidData(
            f"{path} is the result of the recording {place}, which is gone; give the recording "
            "from where it is now"
        )
    own = whole.get("model")
    if model is None and isinstance(own, str):
        model = Path(own)
    return Source(recording=read_recording(place, model=model), result=result)


def note_source(kept: Path, recording: Recording, model: Path | None) -> None:
    """Note in a folder of checkpoints which recording a result is of."""
    folder = recording.folder
    shown = folder.name if folder.parent == kept.resolve() else str(folder)
    whole = {"format": _FORMAT, "recording": shown}
    if model is not None:
        whole["model"] = str(model.resolve())
    write_text(kept / _NOTE, json_text(whole))


def join_recordings(
    kept: Path, sources: Sequence[Source], *, share: float, held_out: Sequence[str] = ()
) -> tuple[Recording, tuple[str, ...]]:
    """Write the runs of several recordings of one machine as one.

    Parameters
    ----------
    kept : Path
        Folder of checkpoints; the recording is written in it.
    sources : sequence of Source
        The recordings, the one that came first before the others.
    share : float
        Share of the runs of the first that is held out.
    held_out : sequence of str
        Runs that are held out in place of those, by their names or the beginnings of them.

    Returns
    -------
    Recording
        All runs, with the model of the first recording.
    tuple of str
        Names of the runs held out: of the first recording those of its result, of each further one
        its last run, where it has two or more.

    Raises
    ------
    InvalidData
        If the models of two recordings differ.
    """
    first = sources[0].recording
    text = first.spec().to_xml()
    runs: list[Run] = [replace(run, name=_stem(run.name)) for run in first.runs]
    taken = list(held_out) or list(_held_of(sources[0], share))
    for number, source in enumerate(sources[1:], start=2):
        own = source.recording
        if own.spec().to_xml() != text:
            raise InvalidData(
                f"the models of {first.folder} and {own.folder} differ; several recordings are "
                "compared with one model: give it as --model"
            )
        stem = _free(f"next{number}", {run.name for run in runs})
        added = [replace(run, name=f"{stem}-{_stem(run.name)}") for run in own.runs]
        runs += added
        if not held_out and len(added) > 1:
            taken.append(added[-1].name)
    joined = write_recording(
        kept / _JOINED, model_xml=first.model_path, runs=runs, overwrite=(kept / _JOINED).exists()
    )
    names = [run.name for run in joined.runs]
    return joined, tuple(n for n in names if any(n == t or _stem(n) == t for t in taken)) or (
        tuple(held_out)
    )


def _held_of(source: Source, share: float) -> tuple[str, ...]:
    """Runs of the first recording that are held out, without the endings of their files."""
    if source.result is not None:
        return tuple(_stem(name) for name in source.result.held_out_runs)
    names = [run.name for run in source.recording.runs]
    if len(names) < 2:
        return ()
    return tuple(_stem(names[k]) for k in split_runs(names, share=share)[1])


def _stem(name: str) -> str:
    path = PurePosixPath(name)
    return str(path.with_suffix("")) if path.suffix in (".csv", ".parquet") else name


def _free(stem: str, names: set[str]) -> str:
    """A beginning of names that none has."""
    while any(name.startswith(f"{stem}-") for name in names):
        stem += "a"
    return stem
