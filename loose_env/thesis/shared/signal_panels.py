"""Panels of the figures that show signals over time, frequency or angle.

The size of a signal: its mean removed, and its rms.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from loose_env.envs import FAINT, INK, MUTED
from loose_env.report import WIDTH, new_figure
from loose_env.typing import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["centred", "panels", "rms"]

_LEFT, _RIGHT, _ABOVE, _BELOW = 0.62, 0.12, 0.30, 0.52
"""Room around panels [inch]."""


def panels(
    titles: Sequence[str], *, across: str, up: Sequence[str], height: float
) -> tuple[Figure, list[Axes]]:
    """Return a figure with one panel above the other.

    ``across``: label of the horizontal axis of the lowest panel. ``height``: height of one panel
    [inch].
    """
    count = len(titles)
    total = count * height + count * _ABOVE + (count - 1) * 0.24 + _BELOW
    figure = new_figure(total)
    found: list[Axes] = []
    for k, (title, label) in enumerate(zip(titles, up, strict=True)):
        bottom = total - (k + 1) * (height + _ABOVE) - k * 0.24
        axes = figure.add_axes(
            (_LEFT / WIDTH, bottom / total, 1 - (_LEFT + _RIGHT) / WIDTH, height / total)
        )
        axes.patch.set_alpha(0.0)
        axes.set_axisbelow(True)
        axes.grid(color=FAINT, linewidth=0.6)
        axes.tick_params(which="both", length=0, pad=5, labelsize=8.5, labelcolor=MUTED)
        for side, spine in axes.spines.items():
            spine.set_visible(side == "bottom")
            spine.set_color(MUTED)
        axes.text(
            0.0,
            1 + 0.07 / height,
            title,
            transform=axes.transAxes,
            color=INK,
            fontsize=9,
            ha="left",
            va="bottom",
        )
        axes.set_ylabel(label, color=MUTED, fontsize=8.5)
        axes.yaxis.set_label_coords(-0.095, 0.5)
        found.append(axes)
    found[-1].set_xlabel(across, color=MUTED, fontsize=9)
    return figure, found


def centred(signal: Array) -> Array:
    """Remove the mean along the last axis, time; the shape stays.

    Examples
    --------
    >>> centred(np.array([1.0, 3.0]))
    array([-1.,  1.])
    """
    return np.asarray(signal - signal.mean(axis=-1, keepdims=True))


def rms(signal: Array) -> float:
    """Root mean square of all values, in the unit of the signal.

    Examples
    --------
    >>> rms(np.array([3.0, -3.0]))
    3.0
    """
    return float(np.sqrt(np.mean(signal**2)))
