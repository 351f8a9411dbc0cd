"""Seats (fault locations), and likelihood of their motion in a block of spectral lines."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loose_env.instrument.data.spectral_lines import Lines
from loose_env.instrument.inference.response.frequency_response import Response
from loose_env.typing import Array, ComplexArray

Products = tuple[Array, Array, ComplexArray, ComplexArray, ComplexArray]

SHARES = np.geomspace(1e-3, 4.0, 14)
"""Grid of a seat's motion over that of a floating seat [1]."""
_FOLDED = 0.2
"""Share of a seat's motion that is too fast for the samples and folded back into the band [1]."""
_STUCK = 0.03
"""Share of a floating seat's motion below which it does not follow a sudden force either [1]."""
BLIND = 1e8
"""Variance of the relative error of a motion of which nothing is known [1]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Seat:
    """Candidate fault location."""

    hypothesis: str
    columns: NDArray[np.intp]
    """Its columns among those of all seats (s',): three slides, or one play."""

    @property
    def slides(self) -> bool:
        """True for a slide, whose direction is unknown."""
        return len(self.columns) > 1


@dataclass(kw_only=True, eq=False)
class Piece:
    """Block of spectral lines with the arm's response and the residual weights."""

    response: Response
    weight: ComplexArray
    """Inverse covariance of the healthy arm's residual (K, c, c)."""
    patterns: ComplexArray
    """Patterns of the variance components over the channels (K, c, Q)."""
    components: NDArray[np.intp]
    """Component of each pattern (Q,)."""
    reading_power: Array
    """Power to which the relative error of the readings applies (K, c)."""
    reading: int
    """Component of the relative error of the readings."""
    base: float
    """Log-likelihood of the healthy arm."""
    temper: float
    """Independent values that a line is worth [1]."""
    bands: NDArray[np.intp]
    """Band of each line (K,)."""

    @property
    def lines(self) -> Lines:
        """Spectral lines of the block."""
        return self.response.lines


def joint_readings(piece: Piece, variances: Array, weighted: ComplexArray) -> ComplexArray:
    """Readings that the joints' motion beside the model most probably makes (K, c)."""
    n = piece.response.at.of.arm.n
    size = np.where(piece.lines.blind, BLIND, variances[piece.components[:n]])
    joints = piece.patterns[:, :, :n]
    return np.asarray(((joints * size) @ (joints.conj().swapaxes(1, 2) @ weighted))[:, :, 0])


def band_terms(piece: Piece, seat: Seat, axes: Array) -> Array:
    """Log-likelihood ratio by axis, band and share (U, bands, shares)."""
    response = piece.response
    terms = seat_products(piece, seat, axes)
    floating = over_lines(response.floating(seat.columns, axes) ** 2)
    first, second = seat_powers(response, SHARES[:, None, None], floating)  # (shares, U, K)
    gain = piece.temper * np.subtract(*explained(terms, first, second))
    edges = np.flatnonzero(np.diff(piece.bands, prepend=-1))
    return np.asarray(np.add.reduceat(gain, edges, axis=2).transpose(1, 2, 0))


def seat_products(piece: Piece, seat: Seat, axes: Array) -> Products:
    """Weighted inner products of a seat's regressors and the residual.

    A seat with impacts on its stops moves faster than samples follow. What of that is folded back
    into the band shows as inertia alone answers it: a second pattern beside the first.
    """
    response = piece.response
    first = response.columns[:, :, seat.columns]
    second = response.sudden[:, seat.columns]
    weighted = piece.weight @ first
    other = piece.weight @ second
    residual = response.residual

    pairs = (axes[:, :, None] * axes[:, None, :]).reshape(len(axes), -1)

    def form(left: Any, right: ComplexArray) -> ComplexArray:
        gram = left.conj().swapaxes(-2, -1) @ right
        return np.asarray(pairs @ gram.reshape(len(gram), -1).T)

    return (
        form(first, weighted).real,
        form(second, other).real,
        form(first, other),
        axes @ (weighted.conj().swapaxes(1, 2) @ residual[:, :, None])[:, :, 0].T,
        axes @ (other.conj().swapaxes(1, 2) @ residual[:, :, None])[:, :, 0].T,
    )


def seat_powers(response: Response, share: Array, floating: Array) -> tuple[Array, Array]:
    """Seat acceleration power below the Nyquist frequency, and aliased power.

    A sensor that is read just after a command has stepped also sees the seat follow that step by
    inertia alone, whatever the stops do to it later.
    """
    omega, period = 2 * np.pi * response.lines.frequency, response.lines.period
    late = np.abs(np.exp(0.5j * omega * period) / np.sinc(omega * period / (2 * np.pi)) - 1)
    stepped = (late * response.lines.sampled) ** 2 * share**2 / (share**2 + _STUCK**2)
    first = share**2 * floating
    return first, _FOLDED**2 * first + stepped * floating


def explained(terms: Products, first: Array, second: Array) -> tuple[Array, Array]:
    """Reduction of the chi-square by a seat's motion, and its log-determinant."""
    g11, g22, g12, b1, b2 = terms
    a, b = first, second
    # Written without differences of large products: both terms in brackets are never negative
    # (Cauchy-Schwarz), and rounding alone would make them so where the regressors are collinear.
    determinant = 1 + a * g11 + b * g22 + a * b * np.maximum(g11 * g22 - np.abs(g12) ** 2, 0.0)
    # b^H (P^-1 + G)^-1 b with P = diag(a, b)
    own, other = np.abs(b1) ** 2, np.abs(b2) ** 2
    both = np.maximum(g22 * own + g11 * other - 2 * (b1.conj() * g12 * b2).real, 0.0)
    found = (a * own + b * other + a * b * both) / determinant
    return found, np.log(determinant)


def over_lines(power: Array) -> Array:
    """Moving average of a power over neighbouring lines (U, K)."""
    count = power.shape[1]
    width = min(9, count)
    first = np.arange(-(width // 2), count - width // 2 + width - 1)
    sums = np.zeros((len(power), len(first) + 1))
    np.cumsum(power[:, np.clip(first, 0, count - 1)], axis=1, out=sums[:, 1:])
    return np.asarray((sums[:, width:] - sums[:, :-width]) / width)
