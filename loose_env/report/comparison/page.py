"""Page of a comparison: text, table and figures in one file that loads nothing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from loose_env.errors import InvalidData
from loose_env.report.pages.figure_card import FigureCard
from loose_env.report.pages.table import PageTable
from loose_env.report.pages.template import paragraphs, shown, template


def render_page(
    *,
    title: str,
    table: Sequence[Mapping[str, object]],
    figures: Sequence[FigureCard | PageTable],
    text: str | Sequence[str],
    result: str | Sequence[str] = (),
    colours: Mapping[str, str] | None = None,
    table_note: str = "",
    timeline: Sequence[FigureCard] = (),
    timeline_text: str | Sequence[str] = (),
    notes: str | Sequence[str] = (),
) -> str:
    """Return the page of a comparison of agents.

    Parameters
    ----------
    title : str
        Title of the page.
    table : sequence of mapping
        One row an agent. The keys of the first row are the columns; the first of them names
        the agent.
    figures : sequence of FigureCard or PageTable
        Figures and further tables in order. In a section tables stand above figures.
    text : str or sequence of str
        Paragraphs that stand first: what was played.
    result : str or sequence of str
        Paragraphs about the outcome; the first of them stands out.
    colours : mapping, optional
        Colour of each agent, ``#rrggbb``, shown beside its name in the table.
    table_note : str
        A sentence below the table: what its columns mean.
    timeline : sequence of FigureCard
        One episode in pictures.
    timeline_text, notes : str or sequence of str
        Paragraphs above the timeline and at the foot of the page.

    Raises
    ------
    InvalidData
        If a figure cannot be shown, or rows of the table have different columns.
    MissingExtra
        If jinja2 is not installed.
    """
    page: str = template("loose_env.report/page.html").render(
        title=title,
        text=paragraphs(text),
        result=paragraphs(result),
        table=_table(PageTable(rows=table, note=table_note)) if table else None,
        colours=dict(colours or {}),
        groups=_groups(figures),
        timeline=[shown(item, f"s{k}") for k, item in enumerate(timeline)],
        timeline_text=paragraphs(timeline_text),
        notes=paragraphs(notes),
    )
    return page


def _groups(items: Sequence[FigureCard | PageTable]) -> list[dict[str, Any]]:
    """Put figures and tables under their headings."""
    groups: list[dict[str, Any]] = []
    for k, whole in enumerate(items):
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
