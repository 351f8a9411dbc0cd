"""What ``recording.json`` says: the model, the runs and what is known of each."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

from loose_env.errors import InvalidData
from loose_env.recording.columns import nearest
from loose_env.recording.folder import read_text
from loose_env.recording.run import Condition

__all__ = ["DESCRIPTION", "FORMAT", "Description", "RunEntry", "read_description"]

DESCRIPTION = "recording.json"
"""File that makes a folder a recording."""
FORMAT = "loose-recording/1"
"""The format read and written here."""

_MOST_BYTES = 2**24
_KEYS = ("format", "model", "runs")
_RUN_KEYS = ("file", "excited", "pose", "condition", "planned")


@dataclass(frozen=True, kw_only=True)
class RunEntry:
    """What is said of one run."""

    file: str
    excited: tuple[str, ...]
    pose: Mapping[str, float] | None
    """Positions [rad or m]."""
    condition: Condition
    planned: bool = False
    """True for a run that is left out as long as its file is not there."""


@dataclass(frozen=True, kw_only=True)
class Description:
    """What ``recording.json`` says."""

    model: str
    runs: tuple[RunEntry, ...]


def read_description(file: Path) -> Description:
    """Read ``recording.json``; whether its names exist in the model is not looked at here.

    Raises
    ------
    InvalidData
        If it is not UTF-8, not JSON, or not this format: a key missing, unknown or twice, a
        value of another type, a number that is not finite.
    """
    text = read_text(file, DESCRIPTION, _MOST_BYTES)
    try:
        whole = json.loads(text, object_pairs_hook=_once, parse_constant=_no_constant)
    except InvalidData:
        raise
    except RecursionError:
        raise InvalidData(f"{DESCRIPTION}: nested too deeply") from None
    except ValueError as error:
        raise InvalidData(f"{DESCRIPTION}: not JSON: {error}") from None
    if not isinstance(whole, dict):
        raise InvalidData(
            f"{DESCRIPTION}: an object with {list(_KEYS)} is needed, got {_is(whole)}"
        )
    if whole.get("format", FORMAT) != FORMAT:
        raise InvalidData(
            f"{DESCRIPTION}: format is {whole['format']!r:.60}; this version reads {FORMAT!r}"
        )
    _keys(DESCRIPTION, whole, _KEYS, _KEYS)
    model = _string(f"{DESCRIPTION}: model", whole["model"])
    runs = whole["runs"]
    if not isinstance(runs, list) or not runs:
        raise InvalidData(f"{DESCRIPTION}: runs is a list of at least one run, got {_is(runs)}")
    entries = tuple(_entry(f"{DESCRIPTION}: runs[{i}]", run) for i, run in enumerate(runs))
    return Description(model=model, runs=entries)


def _entry(place: str, run: Any) -> RunEntry:
    if not isinstance(run, dict):
        raise InvalidData(f'{place} is an object such as {{"file": "run-01.csv"}}, got {_is(run)}')
    _keys(place, run, ("file",), _RUN_KEYS)
    condition = run.get("condition", "suspect")
    if condition not in get_args(Condition):
        raise InvalidData(
            f"{place}.condition is {condition!r:.60}; it is one of {list(get_args(Condition))}"
        )
    excited = run.get("excited", [])
    if not isinstance(excited, list):
        raise InvalidData(f"{place}.excited is a list of joints, got {_is(excited)}")
    joints = [_string(f"{place}.excited[{i}]", joint) for i, joint in enumerate(excited)]
    if len(set(joints)) < len(joints):
        raise InvalidData(f"{place}.excited names a joint twice: {joints}")
    pose = run.get("pose")
    if "pose" in run and not isinstance(pose, dict):
        raise InvalidData(f"{place}.pose is an object of joints and positions, got {_is(pose)}")
    if pose is not None:
        pose = {joint: _number(f"{place}.pose[{joint!r}]", value) for joint, value in pose.items()}
    planned = run.get("planned", False)
    if not isinstance(planned, bool):
        raise InvalidData(f"{place}.planned is true or false, got {_is(planned)}")
    return RunEntry(
        file=_string(f"{place}.file", run["file"]),
        excited=tuple(joints),
        pose=pose,
        condition=condition,
        planned=planned,
    )


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in pairs:
        if key in found:
            raise InvalidData(f"{DESCRIPTION}: the key {key!r} stands twice in one object")
        found[key] = value
    return found


def _no_constant(word: str) -> float:
    raise InvalidData(f"{DESCRIPTION}: {word} is no number of JSON; leave the entry out")


def _keys(
    place: str, given: Mapping[str, Any], needed: Sequence[str], known: Sequence[str]
) -> None:
    missing = [key for key in needed if key not in given]
    if missing:
        raise InvalidData(f"{place}: {missing[0]!r} is missing; it has the keys {list(known)}")
    for key in given:
        if key not in known:
            raise InvalidData(
                f"{place}: unknown key {key!r}; known are {list(known)}{nearest(key, known)}"
            )


def _string(place: str, value: Any) -> str:
    if not isinstance(value, str) or not value:
        raise InvalidData(f"{place} is a name in quotes, got {_is(value)}")
    return value


def _number(place: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise InvalidData(f"{place} is a position in rad or m, got {_is(value)}")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise InvalidData(f"{place} has to be finite, got {value!s:.30}")
    return number


def _is(value: Any) -> str:
    words = repr(value)
    return words if len(words) <= 60 else f"{words[:60]}..."
