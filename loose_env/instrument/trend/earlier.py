"""Diagnoses of earlier sessions, read from results, session folders or recordings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from loose_env.errors import InvalidData
from loose_env.instrument.result import Diagnosis, read_diagnosis

_RESULT, _RECORDING = "result.json", "recording.json"


def read_sessions(
    paths: Sequence[str | Path], diagnose: Callable[[Path], Diagnosis]
) -> list[tuple[str, Diagnosis]]:
    """Diagnoses of earlier sessions, with their names.

    Parameters
    ----------
    paths : sequence of path-like
        Results (``result.json``), folders that hold one or whose folder ``diagnosis`` or another
        one does, and folders of recordings.
    diagnose : callable
        Diagnoses the recording in a folder, where there is no result with transmission spectra.

    Returns
    -------
    list of (str, Diagnosis)
        In the order given; a session that is given twice counts once.

    Raises
    ------
    InvalidData
        If a path is none of these, or cannot be read.

    Examples
    --------
    >>> read_sessions(["no/such/session"], lambda folder: None)
    Traceback (most recent call last):
    ...
    loose_env.errors.InvalidData: no/such/session: there is no such file or folder; ...
    """
    found: dict[Path, tuple[str, Diagnosis]] = {}
    for given in paths:
        path = Path(given)
        if path.resolve() not in found:
            found[path.resolve()] = (str(given), _session(path, diagnose))
    return list(found.values())


def _session(path: Path, diagnose: Callable[[Path], Diagnosis]) -> Diagnosis:
    if path.is_file():
        return read_diagnosis(path)
    if not path.is_dir():
        raise InvalidData(
            f"{path}: there is no such file or folder; an earlier session is a result.json, the "
            "folder of a session or of a diagnosis, or a recording"
        )
    result = _first(path, _RESULT, "diagnosis")
    found = None if result is None else read_diagnosis(result)
    if found is not None and found.spectra:
        return found
    recording = _first(path, _RECORDING, "recording")
    if recording is not None:
        return diagnose(recording.parent)
    if found is None:
        raise InvalidData(
            f"{path}: neither a {_RESULT} nor a {_RECORDING} is in this folder or in one inside it"
        )
    return found


def _first(folder: Path, name: str, usual: str) -> Path | None:
    """A file of the folder, of its folder of the usual name, or of its one other folder with it."""
    for place in (folder, folder / usual):
        if (place / name).is_file():
            return place / name
    others = sorted(folder.glob(f"*/{name}"))
    if len(others) > 1:
        words = ", ".join(str(each.parent.name) for each in others[:3])
        raise InvalidData(f"{folder}: several folders in it hold a {name} ({words}); give one")
    return others[0] if others else None
