"""Rows of a study stored case by case, its figures saved, its tables written into a page."""

from __future__ import annotations

import json
import platform
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from loose_agents.jobs import BackendSettings, ProgressLine, results_of

import loose_env
from loose_env.arms import Arm, planar, scara, six_axis, vera
from loose_env.errors import InvalidData, InvalidSetting, UnknownName
from loose_env.io import plain, write_text

ROOT = Path(__file__).resolve().parents[1]
MARKS = ("<!-- {}: begin -->", "<!-- {}: end -->")
"""Lines of a page between which generated text of a name goes."""
HERE = BackendSettings(backend="threading", workers=1)
"""Cases one after the other in this process."""

Row = dict[str, Any]


def study_rows(
    path: Path,
    cases: Sequence[Any],
    work: Callable[..., Sequence[Row]],
    case_of: Callable[[Row], Any],
    *,
    script: str,
    settings: Any,
    order: Callable[[Row], Any] | None = None,
    digits: int = 4,
    unit: str = "cases",
    backend: BackendSettings = HERE,
    afresh: bool = False,
) -> list[Row]:
    """Rows of all cases: those stored from the same settings and version, and the missing ones.

    Rows are written after every case: the same command goes on where it was stopped.

    Parameters
    ----------
    path : Path
        File of the rows.
    cases : sequence
        Cases in order, hashable.
    work : callable
        Gives the rows of a case from the case and, by keyword, the settings. At the top of a module
        where cases run in processes.
    case_of : callable
        Case to which a row belongs.
    script : str
        Path of the script from the root of the repository.
    settings : dataclass
        All that the rows depend on.
    order : callable, optional
        Key by which rows are sorted; the order of the cases by default.
    digits : int
        Significant digits of the rows; four are more than most studies hold.
    unit : str
        What the cases are called.
    backend : BackendSettings
        Where the cases run; no row depends on it.
    afresh : bool
        Work out again what is stored.
    """
    head = _head(script, settings)
    stored = read_study(path) if path.exists() and not afresh else {}
    same = stored and all(stored.get(key) == value for key, value in head.items())
    rows: list[Row] = list(stored["rows"]) if same else []
    places = {case: k for k, case in enumerate(cases)}
    done = set(map(case_of, rows))
    missing = [case for case in places if case not in done]
    path.parent.mkdir(parents=True, exist_ok=True)

    def place(row: Row) -> Any:
        return places.get(case_of(row), len(places))

    with ProgressLine(len(places), done=len(places) - len(missing), unit=unit) as line:
        for position, found in results_of(partial(work, settings=settings), missing, backend):
            rows = sorted([*rows, *plain(list(found), digits=digits)], key=order or place)
            start = json.dumps(head, indent=1).removesuffix("\n}")
            lines = ",\n".join("  " + json.dumps(row) for row in rows)
            write_text(path, f'{start},\n "rows": [\n{lines}\n ]\n}}\n')
            line.advance(1, str(missing[position]))
    return [row for row in rows if case_of(row) in places]


def _head(script: str, settings: Any) -> Row:
    """What the rows rest on, as it will be read back from a file."""
    versions = {"loose_env": loose_env.__version__, "mujoco": mujoco.__version__}
    versions |= {"numpy": np.__version__, "python": platform.python_version()}
    head = {"made_by": script, "settings": asdict(settings), "versions": versions}
    read_back: Row = json.loads(json.dumps(head))
    return read_back


def read_study(path: Path) -> dict[str, Any]:
    """Read the file of a study: its rows, and what they rest on."""
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise InvalidData(
            f"{path} is no whole JSON file ({error}); remove it, or give another"
        ) from error
    if not isinstance(stored, dict) or not isinstance(stored.get("rows"), list):
        raise InvalidData(f"{path} holds no rows of a study; remove it, or give another file")
    return stored


def write_between(page: Path, text: str, *, name: str = "tables", new: str | None = None) -> None:
    """Write tables between their marks on a page, ``new`` where there is none yet."""
    if new is None and not page.is_file():
        raise InvalidSetting(f"{page} does not exist; name a page that has marks for tables")
    old = new if new is not None and not page.exists() else page.read_text(encoding="utf-8")
    write_text(page, between(old, text, name, page))


def between(old: str, text: str, name: str, page: Path) -> str:
    """Text of a page with other lines between the marks of a name."""
    first, last = (mark.format(name) for mark in MARKS)
    before, begin, rest = old.partition(first)
    _, end, after = rest.partition(last)
    if not (begin and end):
        raise InvalidSetting(
            f"{page} lacks the lines {first!r} and {last!r}, between which tables go"
        )
    return f"{before}{first}\n\n{text}\n\n{last}{after}"


def arm_named(name: str) -> Arm:
    """Build an arm: by its function's name, or planar with its number of links and v if vertical.

    Examples
    --------
    >>> arm_named("planar3v").n
    3
    """
    known = {"vera": vera, "six_axis": six_axis, "scara": scara}
    if name in known:
        return known[name]()
    links = name.replace("-vertical", "v").removeprefix("planar")
    count = links.removesuffix("v") or "4"
    if not (name.startswith("planar") and count.isdecimal()):
        raise UnknownName(f"there is no arm {name!r}; there are {', '.join(known)} and planar4[v]")
    return planar(int(count), vertical=links.endswith("v"))
