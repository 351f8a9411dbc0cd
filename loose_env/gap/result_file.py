"""The text of a result file, and reading it back with errors that name the file."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from loose_env.errors import InvalidData
from loose_env.gap.plain import plain

__all__ = ["json_text", "read_result_file", "whole_of"]

T = TypeVar("T")


def json_text(whole: Mapping[str, Any], *, digits: int = 7) -> str:
    """Text of a file; numbers that are not finite become null.

    Examples
    --------
    >>> print(json_text({"gap": 2 / 3, "after": float("inf")}, digits=3), end="")
    {
     "gap": 0.667,
     "after": null
    }
    """
    values = plain(whole, digits=digits)
    return json.dumps(values, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def whole_of(text: str, *, format: str, noun: str) -> dict[str, Any]:
    """Read the text of a file of some format.

    Parameters
    ----------
    text : str
        The text.
    format : str
        What its "format" has to be.
    noun : str
        What errors call it.

    Raises
    ------
    InvalidData
        If it is no JSON, or none of the format.
    """
    try:
        whole = json.loads(text, parse_constant=_refused)
    except (ValueError, RecursionError) as error:
        raise InvalidData(f"the {noun} is no JSON: {error}") from None
    if not isinstance(whole, dict) or whole.get("format") != format:
        given = whole.get("format") if isinstance(whole, dict) else whole
        raise InvalidData(f"a {noun} of the format {format!r} is needed, not {given!r:.60}")
    return whole


def read_result_file(path: str | Path, parse: Callable[[str], T], *, noun: str) -> T:
    """Read a file, or ``result.json`` of a folder; errors begin with the file's name.

    Parameters
    ----------
    path : str or Path
        The file, or the folder.
    parse : callable
        Makes of the text what it stands for.
    noun : str
        What errors call it.

    Raises
    ------
    InvalidData
        If it cannot be read, or ``parse`` refuses it.
    """
    file = Path(path)
    if file.is_dir():
        file = file / "result.json"
    try:
        text = file.read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidData(f"{file}: the {noun} cannot be read: {error}") from None
    try:
        return parse(text)
    except InvalidData as error:
        raise InvalidData(f"{file}: {error}") from None


def _refused(word: str) -> float:
    """Refuse the words for numbers that JSON does not have."""
    raise ValueError(f"{word} is no number of JSON; unknown ones are null")
