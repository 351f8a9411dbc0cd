"""A page that holds all it shows: words, a table, figures, and nothing from elsewhere."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from loose_env.errors import InvalidData
from loose_env.report.pages.figure_card import FigureCard
from loose_env.report.pages.table import PageTable
from loose_env.report.pages.template import paragraphs, shown, template, write_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure


Image = FigureCard | tuple[str, "bytes | Figure"]
"""A card, or its caption and its image."""


def write_comparison_page(
    path: str | os.PathLike[str],
    *,
    title: str,
    table: Sequence[Mapping[str, object]],
    figures: Sequence[Image | PageTable],
    text: str | Sequence[str],
    result: str | Sequence[str] = (),
    colours: Mapping[str, str] | None = None,
    table_note: str = "",
    timeline: Sequence[Image] = (),
    timeline_text: str | Sequence[str] = (),
    notes: str | Sequence[str] = (),
) -> Path:
    """Write the page of a comparison of agents.

    The file is written beside its final name and renamed into place.

    Parameters
    ----------
    path : path-like
        Where the page goes; its folder is made where there is none.
    title : str
        Title of the page.
    table : sequence of mapping
        One row an agent. The keys of the first row are the columns; the first of them names
        the agent.
    figures : sequence of FigureCard, (caption, image) or PageTable
        Figures and further tables in order; an image is a matplotlib figure, or an SVG or a PNG
        as bytes. In a section tables stand above figures.
    text : str or sequence of str
        Paragraphs that stand first: what was played.
    result : str or sequence of str
        Paragraphs about the outcome; the first of them stands out.
    colours : mapping, optional
        Colour of each agent, ``#rrggbb``, shown beside its name in the table.
    table_note : str
        A sentence below the table: what its columns mean.
    timeline : sequence of FigureCard or (caption, image)
        One episode in pictures.
    timeline_text, notes : str or sequence of str
        Paragraphs above the timeline and at the foot of the page.

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    InvalidData
        If a figure cannot be shown, or rows of the table have different columns.
    MissingExtra
        If jinja2 is not installed.
    """
    page = render_page(
        title=title,
        table=table,
        figures=figures,
        text=text,
        result=result,
        colours=colours,
        table_note=table_note,
        timeline=timeline,
        timeline_text=timeline_text,
        notes=notes,
    )
    return write_whole(path, page)


def render_page(
    *,
    title: str,
    table: Sequence[Mapping[str, object]],
    figures: Sequence[Image | PageTable],
    text: str | Sequence[str],
    result: str | Sequence[str] = (),
    colours: Mapping[str, str] | None = None,
    table_note: str = "",
    timeline: Sequence[Image] = (),
    timeline_text: str | Sequence[str] = (),
    notes: str | Sequence[str] = (),
) -> str:
    """Return the page that `write_comparison_page` writes."""
    page: str = template("loose_env.report/page.html").render(
        title=title,
        text=paragraphs(text),
        result=paragraphs(result),
        table=_table(PageTable(rows=table, note=table_note)) if table else None,
        colours=dict(colours or {}),
        groups=_groups(figures),
        timeline=[shown(_card(item), f"s{k}") for k, item in enumerate(timeline)],
        timeline_text=paragraphs(timeline_text),
        notes=paragraphs(notes),
    )
    return page


def _card(item: Image) -> FigureCard:
    return item if isinstance(item, FigureCard) else FigureCard(caption=item[0], image=item[1])


def _groups(items: Sequence[Image | PageTable]) -> list[dict[str, Any]]:
    """Put figures and tables under their headings."""
    groups: list[dict[str, Any]] = []
    for k, item in enumerate(items):
        whole = item if isinstance(item, PageTable) else _card(item)
        if whole.heading or not groups:
            head = {"heading": whole.heading, "intro": whole.intro}
            groups.append({**head, "tables": [], "cards": []})
        if isinstance(whole, PageTable):
            groups[-1]["tables"].append(_table(whole))
        else:
            groups[-1]["cards"].append(shown(whole, f"f{k}"))
    return groups


def _table(table: PageTable) -> dict[str, Any]:
    """Columns and cells of a table, as text."""
    columns = list(table.rows[0])
    for row in table.rows:
        if list(row) != columns:
            raise InvalidData(f"every row of the table has columns {columns}, got {list(row)}")
    return {
        "title": table.title,
        "note": table.note,
        "columns": columns,
        "rows": [[str(value) for value in row.values()] for row in table.rows],
    }
