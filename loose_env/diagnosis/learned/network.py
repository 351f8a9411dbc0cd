"""Learned likelihood of one record by location of the loose seat.

A small network maps the features of one location (`loose_env.diagnosis.learned.features`) to the
log-likelihood ratio of a loose seat there over a healthy arm, one for every node of friction. All
locations share its weights, beside a short vector for the link or joint. The pass is written in
numpy, the weights are plain arrays.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from loose_env.errors import InvalidData

__all__ = ["SeatNetwork"]

Array = NDArray[np.floating]

_SHAPES: dict[str, tuple[str, ...]] = {
    "place_mean": ("C",),
    "place_scale": ("C",),
    "record_mean": ("Q",),
    "record_scale": ("Q",),
    "place.weight": ("W", "C"),
    "place.bias": ("W",),
    "record_in.weight": ("W", "Q"),
    "record_in.bias": ("W",),
    "record_out.weight": ("W", "W"),
    "record_out.bias": ("W",),
    "hypothesis.weight": ("W", "H"),
    "hidden.weight": ("W", "W"),
    "hidden.bias": ("W",),
    "out.weight": ("F", "W"),
    "out.bias": ("F",),
    "temper": ("R",),
}


class SeatNetwork:
    """The pass of a trained network.

    Parameters
    ----------
    tensors : mapping of str to ndarray
        Weights and scales, named and shaped as `SeatNetwork.shapes` says: C features of a location,
        Q of a record, W hidden units, H hypotheses with a fault, F nodes of friction, R numbers
        of records that have a temper of their own.

    Raises
    ------
    InvalidData
        If a tensor is missing, its shape does not fit the others, or it is not finite.
    """

    shapes = _SHAPES
    """Names of the tensors and their shapes, in letters."""

    def __init__(self, tensors: Mapping[str, Array]) -> None:
        sizes: dict[str, int] = {}
        for name, letters in _SHAPES.items():
            if name not in tensors:
                raise InvalidData(f"the network has no tensor {name!r}; it needs {list(_SHAPES)}")
            shape = tensors[name].shape
            wanted = tuple(sizes.setdefault(x, n) for x, n in zip(letters, shape, strict=False))
            if len(shape) != len(letters) or shape != wanted:
                raise InvalidData(
                    f"tensor {name!r} of the network has shape {shape}, which does not fit "
                    f"{letters} with {sizes}"
                )
            if not np.isfinite(tensors[name]).all():
                raise InvalidData(
                    f"tensor {name!r} of the network holds values that are not finite; train it "
                    "again with scripts/agents/train_posterior.py"
                )
        self.sizes = sizes
        self.tensors = {name: np.asarray(tensors[name], dtype=np.float32) for name in _SHAPES}

    @property
    def frictions(self) -> int:
        """Number of nodes of friction."""
        return self.sizes["F"]

    def hidden(
        self, location: Array, record: Array, hypothesis: NDArray[np.intp]
    ) -> NDArray[np.float32]:
        """Last hidden layer of every location.

        Parameters
        ----------
        location : ndarray (P, C)
            Features of the locations.
        record : ndarray (Q,)
            Features of the record.
        hypothesis : ndarray of int (P,)
            Hypothesis of each location.

        Returns
        -------
        ndarray (P, W)
        """
        w = self.tensors
        x = (location.astype(np.float32) - w["place_mean"]) / w["place_scale"]
        r = (record.astype(np.float32) - w["record_mean"]) / w["record_scale"]
        whole = _silu(w["record_in.weight"] @ r + w["record_in.bias"])
        whole = w["record_out.weight"] @ whole + w["record_out.bias"]
        y = x @ w["place.weight"].T + w["place.bias"] + whole
        y += w["hypothesis.weight"].T[hypothesis]
        return _silu(_silu(y) @ w["hidden.weight"].T + w["hidden.bias"])

    def likelihood(
        self, location: Array, record: Array, hypothesis: NDArray[np.intp]
    ) -> NDArray[np.float64]:
        """Log-likelihood ratio over a healthy arm, by location and friction (P, F)."""
        hidden = self.hidden(location, record, hypothesis)
        return (hidden @ self.tensors["out.weight"].T + self.tensors["out.bias"]).astype(float)

    def temper(self, records: int) -> float:
        """Exponent on the likelihood of so many records: those of one arm share its mismatch."""
        tempers = self.tensors["temper"]
        return float(np.exp(tempers[min(max(records, 1), len(tempers)) - 1]))


def _silu(x: Array) -> NDArray[np.float32]:
    return np.asarray(x * expit(x), dtype=np.float32)
