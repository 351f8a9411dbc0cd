"""Generated text between marks of a page, and arms by name."""

from __future__ import annotations

from pathlib import Path

from loose_env.arms import Arm, planar, scara, six_axis, vera
from loose_env.errors import InvalidSetting, UnknownName
from loose_env.io import write_text

ROOT = Path(__file__).resolve().parents[1]
MARKS = ("<!-- {}: begin -->", "<!-- {}: end -->")
"""Lines of a page between which generated text of a name goes."""


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
