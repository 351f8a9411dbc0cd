"""Parts of what a notebook shows: tables, bars and lists in HTML without a style sheet.

Notebooks bring their own style, light or dark, so colours are those of the text around.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

from loose_env.envs import palette as ink

__all__ = ["aligned", "bar", "bullets", "cells_table"]

_WIDTH, _HEIGHT = 120, 10
"""Size of a bar [px]."""


def bar(share: float, *, colour: str = ink.MEASURED) -> str:
    """Draw a share as a horizontal bar, an SVG element.

    Parameters
    ----------
    share : float
        0 to 1; values outside are clipped.
    colour : str
        Colour of the filled part.

    Examples
    --------
    >>> bar(0.5, colour="red").count('width="60.0"')
    1
    """
    filled = _WIDTH * min(max(share, 0.0), 1.0)
    return (
        f'<svg width="{_WIDTH}" height="{_HEIGHT}" viewBox="0 0 {_WIDTH} {_HEIGHT}" '
        'role="presentation">'
        f'<rect width="{_WIDTH}" height="{_HEIGHT}" fill="currentColor" opacity="0.12"/>'
        f'<rect width="{filled:.1f}" height="{_HEIGHT}" fill="{colour}"/></svg>'
    )


def cells_table(
    heads: Sequence[str], rows: Iterable[Sequence[str]], *, markup: Sequence[int] = ()
) -> str:
    """Format rows as an HTML table; "" if there are none.

    Parameters
    ----------
    heads : sequence of str
        Headings.
    rows : iterable of sequence of str
        Plain texts, one per heading.
    markup : sequence of int
        Columns whose cells are HTML already.

    Examples
    --------
    >>> cells_table(["a"], [["1 < 2"]]).count("<td style='text-align:left'>1 &lt; 2</td>")
    1
    """
    left = "style='text-align:left'"
    lines = [
        "".join(
            f"<td {left}>{cell if k in markup else escape(cell)}</td>" for k, cell in enumerate(row)
        )
        for row in rows
    ]
    if not lines:
        return ""
    head = "".join(f"<th {left}>{escape(name)}</th>" for name in heads)
    table = "<table>" + "".join(f"<tr>{line}</tr>" for line in [head, *lines]) + "</table>"
    return f"<div style='overflow-x:auto'>{table}</div>"  # a narrow screen scrolls it


def bullets(title: str, lines: Sequence[str]) -> str:
    """Format lines as a list under a title; "" if there are none."""
    if not lines:
        return ""
    items = "".join(f"<li>{escape(line)}</li>" for line in lines)
    return f"<p style='margin-bottom:0'>{escape(title)}</p><ul style='margin-top:0'>{items}</ul>"


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Format rows as lines of text with aligned columns.

    Examples
    --------
    >>> aligned([["a", "1"], ["long", ""]])
    ['a     1', 'long']
    """
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)).rstrip() for row in rows
    ]
