"""A picture of the page with the words that go with it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, kw_only=True, eq=False)
class FigureCard:
    """One picture with its words."""

    image: bytes | Figure
    """A figure of matplotlib, or the bytes of an SVG or a PNG."""
    caption: str
    """What there is to see; stands below the picture and is read out in its place."""
    title: str = ""
    """A name that stands on the picture."""
    heading: str = ""
    """What stands above it; pictures without a heading stand beside the one before."""
    intro: str = ""
    """A paragraph below the heading."""
