"""How far a seat opens, given how hard it is driven against its friction.

The table says how openings and loose motion are distributed for a ratio of driving force to
friction. It was measured on simulated horizontal arms by ``scripts/measure_opening.py``: stops
and gaps are averaged over as they occur. Gravity along a seat, as on a vertical arm, is not in
it.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

from loose_env.diagnosis.likelihood import LOOSE, OPENINGS
from loose_env.errors import InvalidData

__all__ = ["RATIOS", "OpeningTable", "shipped_table"]

Array = NDArray[np.float64]

RATIOS = np.geomspace(0.05, 100.0, 20)
"""Driving force over friction at the nodes of the table [1]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class OpeningTable:
    """Probabilities of openings and loose motion."""

    slide: Array
    """For slides (ratios, openings, loose motion)."""
    hinge: Array
    """For play in joints (ratios, openings, loose motion)."""

    def __post_init__(self) -> None:
        shape = (len(RATIOS), len(OPENINGS), len(LOOSE))
        for name in ("slide", "hinge"):
            table = getattr(self, name)
            if table.shape != shape or not (table >= 0).all():
                raise InvalidData(
                    f"an opening table holds probabilities of shape {shape}; {name} has "
                    f"shape {table.shape}"
                )

    @staticmethod
    def nodes(ratio: Array) -> tuple[NDArray[np.intp], Array]:
        """Lower node of each ratio and the share of the upper one, in the logarithm."""
        position = np.interp(np.log(ratio), np.log(RATIOS), np.arange(len(RATIOS)))
        lower = np.minimum(position.astype(np.intp), len(RATIOS) - 2)
        return lower, position - lower


@lru_cache(maxsize=1)
def shipped_table() -> OpeningTable:
    """Return the table that ships with the package."""
    text = files("loose_env.diagnosis").joinpath("opening.json").read_text(encoding="utf-8")
    stored = json.loads(text)
    return OpeningTable(slide=np.array(stored["slide"]), hinge=np.array(stored["hinge"]))
