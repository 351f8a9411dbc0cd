"""Figures the thesis printed, one file a section; only facts, each with its place."""

from __future__ import annotations

import json
from functools import cache
from importlib.resources import files
from typing import Any

from loose_env.errors import UnknownName

__all__ = ["printed"]


@cache
def printed(section: str) -> dict[str, Any]:
    """Figures printed in the thesis for a section.

    Raises
    ------
    UnknownName
        If there is no file of that name.

    Examples
    --------
    >>> printed("tables")["theta2_deg"]
    [122, 98, 56, 28, 302]
    """
    file = files("loose_env.thesis.printed").joinpath(f"{section}.json")
    if not file.is_file():
        known = sorted(
            f.name.removesuffix(".json")
            for f in files("loose_env.thesis.printed").iterdir()
            if f.name.endswith(".json")
        )
        raise UnknownName(f"no printed figures {section!r}; there are {', '.join(known)}")
    found: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    return found
