"""The look that the figures of the studies share."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

__all__ = ["FAINT", "INK", "MUTED", "pyplot", "save_figure"]

INK, MUTED, FAINT = "#1b2128", "#66717d", "#c9d0d7"
"""Colours of text, of what stands behind it, and of lines that only frame."""


def pyplot() -> Any:
    """Matplotlib's pyplot without a window, set to the studies' look."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    plt.rcParams.update(
        {
            "font.size": 9,
            "text.color": INK,
            "axes.edgecolor": FAINT,
            "axes.labelcolor": INK,
            "xtick.color": MUTED,
            "ytick.color": MUTED,
            "axes.spines.top": False,
            "axes.spines.right": False,
        }
    )
    return plt


def save_figure(plt: Any, figure: Any, path: Path, *, dpi: int = 130) -> None:
    """Write a figure beside its place, put it there whole, and close it."""
    beside = path.with_suffix(f".part{path.suffix}")
    figure.savefig(beside, dpi=dpi)
    plt.close(figure)
    os.replace(beside, path)
