"""A section of the reproduction: words, tables that set printed beside found, figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from loose_env.errors import InvalidData
from loose_env.report import Plate

__all__ = ["Section", "Table"]


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table of the page; every cell is text that code has made from a figure."""

    caption: str
    """What the table shows, with the number of the thesis's table or section."""
    columns: tuple[str, ...]
    """Headings; the first column names the row."""
    rows: tuple[tuple[str, ...], ...]
    """Cells, as many in a row as there are columns."""

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.columns):
                raise InvalidData(
                    f"table {self.caption!r} has {len(self.columns)} columns, got the row {row}"
                )


@dataclass(frozen=True, kw_only=True, eq=False)
class Section:
    """One experiment or method of the thesis, reproduced."""

    key: str
    """Short name, also the anchor on the page."""
    title: str
    """Heading, with the thesis's section or experiment."""
    finding: str
    """The outcome in one sentence, printed beside found: for the table at the top of the page."""
    words: Sequence[str]
    """Paragraphs: what was done, what the thesis found, what is found here."""
    tables: Sequence[Table] = ()
    """Tables, printed beside found."""
    plates: Sequence[Plate] = ()
    """Figures."""
    equations: Mapping[str, str] = field(default_factory=dict)
    """Function that implements each equation, by its number: ``{"6.6": "module.function"}``."""
    left_out: Sequence[str] = ()
    """What of the thesis is not reproduced here, and why."""
