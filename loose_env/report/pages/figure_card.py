"""A figure of a report with its caption, title and heading."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, kw_only=True, eq=False)
class FigureCard:
    """One figure with its text."""

    image: bytes | Figure
    """A figure of matplotlib, or the bytes of an SVG or a PNG."""
    caption: str
    """Caption below the figure, and its alternative text."""
    title: str = ""
    """Name above the figure."""
    heading: str = ""
    """Section heading; a figure without one joins the section before."""
    intro: str = ""
    """A paragraph below the heading."""
