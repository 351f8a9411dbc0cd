"""Legends of figures: entries in rows that break where the figure ends."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from loose_env.envs import INK
from loose_env.report.pages.figures import WIDTH

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["LETTERS", "draw_legend", "legend_height", "legend_rows", "shortened"]

LETTERS = 62
"""Letters that fit into one row of a legend."""
_ROW = 0.25
"""Height of a row [inch]."""
_MARK, _LETTER, _LEFT = 0.075, 0.0145, 0.03
"""Width of a mark with its margins and of a letter, and the left margin [figure widths]."""


def shortened(name: str, most: int) -> str:
    """Name of at most so many letters, the middle replaced where it is longer.

    Examples
    --------
    >>> shortened("shoulder_of_the_left_arm", 12), shortened("elbow", 12)
    ('should…t_arm', 'elbow')
    """
    if len(name) <= most:
        return name
    head = most // 2
    return f"{name[:head]}…{name[len(name) - (most - head - 1) :]}"


def legend_rows(words: Sequence[str]) -> list[tuple[int, float]]:
    """Row and left end [figure widths] of each entry."""
    found, row, x = [], 0, _LEFT
    for text in words:
        wide = _MARK + _LETTER * len(text)
        if x + wide > 1.0 and x > _LEFT:
            row, x = row + 1, _LEFT
        found.append((row, x))
        x += wide
    return found


def legend_height(entries: Sequence[tuple[str, str, str]]) -> float:
    """Height of a legend [inch]."""
    return 0.12 + _ROW * (legend_rows(_texts(entries))[-1][0] + 1)


def draw_legend(figure: Figure, entries: Sequence[tuple[str, str, str]], height: float) -> None:
    """Draw mark, colour and words of each entry at the top of a figure.

    Parameters
    ----------
    figure : matplotlib Figure
        Figure of the page's width.
    entries : sequence of (mark, colour, words)
        The entries; longer words than a row are shortened.
    height : float
        Height of the figure [inch].
    """
    texts = _texts(entries)
    for (row, x), (mark, colour, _), words in zip(legend_rows(texts), entries, texts, strict=True):
        y = 1 - (0.16 + _ROW * row) / height
        figure.text(x, y, mark, color=colour, fontsize=10, ha="left", va="center")
        figure.text(
            x + 0.3 / WIDTH - 0.012, y, words, color=INK, fontsize=10, ha="left", va="center",
            parse_math=False,
        )  # fmt: skip


def _texts(entries: Sequence[tuple[str, str, str]]) -> list[str]:
    return [shortened(words, LETTERS) for *_, words in entries]
