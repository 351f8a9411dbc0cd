"""Opening of a seat as a function of driving force, friction and gravity.

The table says how openings and loose motion are distributed. Two figures decide: the driving
force over the friction, which holds a seat wherever it is, and the share of gravity beside
the driving force, which presses it against a stop. A pressed seat that does not stick gives by
the compliance of its stop, and parts from it where the drive overcomes gravity. The table was
measured on simulated arms by ``scripts/agents/measure_opening.py``: stops and gaps are averaged
over as they occur.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files

import numpy as np

from loose_env.diagnosis.likelihood.record_likelihood import LOOSE, OPENINGS
from loose_env.errors import InvalidData
from loose_env.typing import Array, IndexArray

__all__ = ["PRESSES", "RATIOS", "OpeningTable", "shipped_table"]


RATIOS = np.geomspace(0.05, 100.0, 20)
"""Driving force over friction at the nodes of the table [1]."""
PRESSES = np.array([0.0, 0.15, 0.3, 0.5, 1.0])
"""Gravity over the sum of gravity and driving force at the nodes of the table [1]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class OpeningTable:
    """Probabilities of openings and loose motion."""

    slide: Array
    """For slides (presses, ratios, openings, loose motion)."""
    hinge: Array
    """For play in joints (presses, ratios, openings, loose motion)."""

    def __post_init__(self) -> None:
        shape = (len(PRESSES), len(RATIOS), len(OPENINGS), len(LOOSE))
        for name in ("slide", "hinge"):
            table = getattr(self, name)
            if table.shape != shape or not (table >= 0).all():
                raise InvalidData(
                    f"an opening table holds probabilities of shape {shape}; {name} has "
                    f"shape {table.shape}"
                )

    @staticmethod
    def nodes(force: Array, friction: Array, load: Array) -> list[tuple[IndexArray, Array]]:
        """Find the nodes about seats that are driven and held by given forces.

        Parameters
        ----------
        force, friction, load : ndarray (...)
            Rms force that drives a seat, its friction, and gravity's force on it [N, or N·m];
            friction is positive.

        Returns
        -------
        list of (node, weight)
            Index of each of the four nodes about the seat, the tables' first two axes taken
            as one, and its weight, all of the common shape of the parameters. Weights are
            linear in the press and in the logarithm of the ratio.
        """
        ratio = np.maximum(force / friction, RATIOS[0])
        lower, upper = _between(np.log(ratio), np.log(RATIOS))
        few, many = _between(load / np.maximum(load + force, 1e-300), PRESSES)
        return [
            ((few + i) * len(RATIOS) + lower + j, a * b)
            for i, a in enumerate((1 - many, many))
            for j, b in enumerate((1 - upper, upper))
        ]


def _between(values: Array, nodes: Array) -> tuple[IndexArray, Array]:
    """Lower node of each value, and the share of the next one."""
    position = np.interp(values, nodes, np.arange(len(nodes)))
    lower = np.minimum(position.astype(np.intp), len(nodes) - 2)
    return lower, position - lower


@lru_cache(maxsize=1)
def shipped_table() -> OpeningTable:
    """Return the table that ships with the package."""
    text = files("loose_env.diagnosis").joinpath("opening.json").read_text(encoding="utf-8")
    stored = json.loads(text)
    return OpeningTable(slide=np.array(stored["slide"]), hinge=np.array(stored["hinge"]))
