"""Moments of one record: covariances, transmission, apparent inertia, skewness, kurtosis.

Sums are divided by the number of samples.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from loose_env.errors import InvalidData
from loose_env.statistics._checks import as_record, as_samples, band_bins
from loose_env.statistics.spectra import differenced, line_scales
from loose_env.typing import Array

# Below this share of the largest variance a direction counts as not moving: rounding of the
# covariances, not the record, decides what is seen there.
STILL = 1e-12
# Correlation of command and joint acceleration below which the command instruments nothing.
UNRELATED = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Covariances:
    """Covariances of m excitation signals x and d response signals a, means removed.

    Sums are divided by the number of samples. Of several records, each array has further axes in
    front.
    """

    xx: Array
    """cov(x, x), shape (m, m), (rad/s^2)^2 for joint accelerations."""
    xa: Array
    """cov(x, a), shape (m, d), rad/s^2 times m/s^2."""
    aa: Array
    """cov(a, a), shape (d, d), (m/s^2)^2."""
    count: int
    """Number of samples."""


class RecordCovariances(NamedTuple):
    """Covariances of a record with the command that excited it."""

    full: Array
    """Of m commands, m joint accelerations, d tool accelerations (..., 2 m + d, 2 m + d)."""
    x_a: Covariances
    """Of the joint accelerations with the tool acceleration."""
    command_x: Covariances
    """Of the command with the joint accelerations."""
    command_a: Covariances
    """Of the command with the tool acceleration."""

    @classmethod
    def of(cls, full: Array, m: int, count: int) -> RecordCovariances:
        """Take them out of those of all signals."""
        u, x, a = slice(m), slice(m, 2 * m), slice(2 * m, None)
        parts = (
            (full[..., p, p], full[..., p, q], full[..., q, q]) for p, q in ((x, a), (u, x), (u, a))
        )
        return cls(full, *(Covariances(*each, count) for each in parts))


def covariances(x: ArrayLike, a: ArrayLike) -> Covariances:
    """Compute the covariances of a record, means removed.

    Parameters
    ----------
    x : array, shape (N,) or (m, N)
        Excitation: joint accelerations, rad/s^2, or joint torques, N m.
    a : array, shape (N,) or (d, N)
        Response: tool acceleration in the tool frame, m/s^2, or joint accelerations.

    Returns
    -------
    Covariances
        What the functions ending in `_from` take.

    Raises
    ------
    InvalidData
        If a shape is wrong, the lengths differ, there are fewer than four samples, a value is
        not finite, a row of x is constant or every row of a is.

    Examples
    --------
    >>> cov = covariances([1.0, -1.0, 1.0, -1.0], [[2.0, -2.0, 2.0, -2.0], [0.0, 0.0, 3.0, -3.0]])
    >>> cov.xa.tolist()
    [[2.0, 1.5]]
    """
    signals = as_record(x, "x"), as_record(a, "a")
    rows, count = signals[0].shape
    _require_alike(x=count, a=signals[1].shape[1])
    joined = np.concatenate(signals)
    with np.errstate(invalid="ignore", over="ignore"):
        means = joined.mean(axis=-1)
        joined -= means[:, None]
        # einsum sums in one fixed order, whatever the number of threads.
        full = np.einsum("in,jn->ij", joined, joined) / count
    _require_moving(full, means, {"x": slice(rows), "a": slice(rows, None)})
    return Covariances(full[:rows, :rows], full[:rows, rows:], full[rows:, rows:], count)


def record_covariances(
    command: ArrayLike, angle: ArrayLike, a: ArrayLike, *, rate: float, band: tuple[float, float]
) -> RecordCovariances:
    """Compute all covariances of a record and its command within a band, in one pass.

    By the lines of the band (Parseval): those of the filtered signals, angles differentiated as by
    `acceleration_from_angle`.

    Parameters
    ----------
    command, angle, a : array, shape (..., m, N), (..., m, N + 2), (..., d, N)
        Commanded torques of the excited joints, N m; their angles, rad; tool acceleration in the
        tool frame, m/s^2. Axes in front are those of several records.
    rate : float
        Sampling rate, Hz.
    band : tuple of float
        Lowest and highest frequency kept, Hz.

    Returns
    -------
    RecordCovariances
        With the errors of `covariances`.

    Examples
    --------
    >>> wave = np.sin(2 * np.pi * 20 * np.arange(102) / 100)
    >>> signals = wave[None, 1:-1], wave[None], wave[None, 1:-1]
    >>> cov = record_covariances(*signals, rate=100.0, band=(10.0, 30.0))
    >>> cov.command_a.xa.round(6).tolist(), (cov.x_a.xa / (40 * np.pi) ** 2).round(6).tolist()
    ([[0.5]], [[-0.5]])
    """
    u, q, tool = (as_samples(own, n) for own, n in ((command, "command"), (angle, "x"), (a, "a")))
    m, count = u.shape[-2], u.shape[-1]
    _require_alike(command=count, x=q.shape[-1] - 2, a=tool.shape[-1])
    kept = band_bins(count, rate, band)
    gain, weight = line_scales(count, rate, kept.start, kept.stop)
    with np.errstate(invalid="ignore", over="ignore"):
        spectra = np.fft.rfft(np.concatenate([u, differenced(q), tool], axis=-2))
        lines = spectra[..., kept] * weight
        lines[..., m : 2 * m, :] *= gain
        parts = lines.view(float)
        full = np.einsum("...in,...jn->...ij", parts, parts)
    own = {"command": slice(m), "x": slice(m, 2 * m), "a": slice(2 * m, None)}
    _require_moving(full, spectra[..., 0].real / count, own)
    return RecordCovariances.of(full, m, count)


def _require_alike(**lengths: int) -> None:
    if len(set(lengths.values())) > 1:
        raise InvalidData(f"the numbers of samples are {lengths}; they must be equal")


def _require_moving(full: Array, means: Array, rows: dict[str, slice]) -> None:
    """Raise unless all is finite, every row of an excitation varies, and one of the tool's."""
    if not np.isfinite(full).all():
        raise InvalidData(f"{' or '.join(rows)} holds NaN, infinite or too large values")
    # What is left of a constant after its mean is removed is rounding.
    moving = _diagonals(full) > (1e-15 * means) ** 2
    if moving.all():
        return
    for name, own in rows.items():
        still = ~moving[..., own]
        if still.all(axis=-1).any() or (name != "a" and still.any()):
            at = "" if name == "a" else f" in row {int(np.argwhere(still)[0, -1])}"
            raise InvalidData(f"{name} is constant{at}; it must vary")


def whitener(aa: Array) -> Array:
    """Return W, shape (..., d, d), with W.T S W = 1 for the tool acceleration's covariance S.

    A direction in which the tool does not move gets a small variance in place of none. That is
    the limit with sensor noise: its correlation with anything is zero.
    """
    values, vectors = np.linalg.eigh(aa)
    scale = np.sqrt(np.maximum(values, STILL * values[..., -1:]))
    return np.asarray(vectors / scale[..., None, :], dtype=np.float64)


def excitation_factor(xx: Array) -> Array:
    """Return the lower Cholesky factor of cov(x, x), shape (..., m, m)."""
    if xx.shape[-1] == 1:
        return np.sqrt(xx)
    dependent = "the rows of x depend on each other; each joint needs an excitation of its own"
    try:
        factor = np.asarray(np.linalg.cholesky(xx), dtype=np.float64)
    except np.linalg.LinAlgError as error:
        raise InvalidData(dependent) from error
    # The square of a pivot is what of a row's variance the rows above leave unexplained.
    if (_diagonals(factor) ** 2 < STILL * _diagonals(xx)).any():
        raise InvalidData(dependent)
    return factor


def solved(a: Array, b: Array) -> Array:
    """Solve a x = b, of one unknown by a division."""
    return np.asarray(b / a if a.shape[-1] == 1 else np.linalg.solve(a, b), dtype=np.float64)


def _diagonals(matrices: Array) -> Array:
    """Diagonals (..., k) of matrices (..., k, k)."""
    return np.asarray(np.diagonal(matrices, axis1=-2, axis2=-1))


# Standard deviation relative to the mean, or of one component to the other, taken as rounding.
ROUNDING = 1e-12


def shape_of(rows: ArrayLike) -> tuple[Array, Array]:
    """Skewness and excess kurtosis of every row of a motion, shape (..., N), each of shape (...).

    E[(X - mu)^3] / sigma^3 and E[(X - mu)^4] / sigma^4 - 3: both zero for a Gaussian motion. Stops
    of unequal stiffness skew it, impacts at the stops raise the kurtosis.

    Raises
    ------
    InvalidData
        If a row is too short, not finite, or constant.

    Examples
    --------
    >>> rows = [[-1.0, 1.0, -1.0, 1.0], [0.0, 0.0, 0.0, 4.0]]
    >>> [values.round(4).tolist() for values in shape_of(rows)]
    [[0.0, 1.1547], [-2.0, -0.6667]]
    """
    record = as_samples(rows, "a")
    with np.errstate(invalid="ignore", over="ignore"):
        means, power, third, fourth = central_moments(record)
    if not np.isfinite(fourth).all():
        raise InvalidData("a holds NaN, infinite or too large values")
    if (np.sqrt(power) <= ROUNDING * np.abs(means)).any():
        raise InvalidData("a is constant in a component asked for; it must vary")
    return np.asarray(third / power**1.5), np.asarray(fourth / power**2 - 3.0)


def central_moments(rows: Array) -> tuple[Array, Array, Array, Array]:
    """Mean, and second, third and fourth moment about it, of rows (..., N) each."""
    means, count = rows.mean(axis=-1), rows.shape[-1]
    off = rows - means[..., None]
    square = off * off
    third, fourth = np.vecdot(square, off) / count, np.vecdot(square, square) / count
    return means, square.mean(axis=-1), third, fourth


def transmission_from(cov: Covariances) -> Array:
    """Regress the tool acceleration on the accelerations of the excited joints.

    B = C Sx^-1 with C = cov(a, x) and Sx = cov(x). Noise in x shrinks it: then use
    `transmission_by_instrument_from`.

    Parameters
    ----------
    cov : Covariances
        Of the joints' accelerations with the tool's. Axes in front are those of several records.

    Returns
    -------
    array, shape (..., d, m)
        B, m/s^2 per rad/s^2.

    Raises
    ------
    InvalidData
        If the rows of x depend on each other.

    Examples
    --------
    >>> x = [1.0, -1.0, 1.0, -1.0]
    >>> transmission_from(covariances(x, [[0.5, -0.5, 0.5, -0.5], [1, 1, -1, -1]])).tolist()
    [[0.5], [0.0]]
    """
    factor = excitation_factor(cov.xx)
    return solved(factor.mT, solved(factor, cov.xa)).mT


def transmission_by_instrument_from(command_x: Covariances, command_a: Covariances) -> Array:
    """Estimate the transmission with the command as instrument: noise in x does not shrink it.

    B = cov(a, u) cov(x, u)^-1, the instrumental-variable estimate (Soderstrom and Stoica,
    Instrumental Variable Methods for System Identification, 1983).

    Parameters
    ----------
    command_x, command_a : Covariances
        Of the commanded torques u of the excited joints with their accelerations x, and with the
        tool acceleration a. Axes in front are those of several records.

    Returns
    -------
    array, shape (..., d, m)
        B, m/s^2 per rad/s^2.

    Raises
    ------
    InvalidData
        If there is not one command for each row of x, or x does not follow it.

    Examples
    --------
    >>> u, noisy = [1.0, -1.0, 1.0, -1.0], [3.0, -1.0, 1.0, -3.0]
    >>> transmission_by_instrument_from(covariances(u, noisy), covariances(u, [u, u])).tolist()
    [[0.5], [0.5]]
    """
    _require_related(command_x)
    return solved(command_x.xa, command_a.xa).mT


def apparent_inertia_from(command_x: Covariances) -> Array:
    """Estimate the apparent inertia of the excited joints, M = cov(u, u) cov(x, u)^-1.

    Noise in x does not shrink it. M[i, i] is what joint i feels while the other excited joints do
    not accelerate, M[i, j] the torque on joint i by the acceleration of joint j.

    Parameters
    ----------
    command_x : Covariances
        Of the commanded torques u with the joint accelerations x.

    Returns
    -------
    array, shape (..., m, m)
        M, N m per rad/s^2.

    Raises
    ------
    InvalidData
        As `transmission_by_instrument_from`.

    Examples
    --------
    >>> apparent_inertia_from(covariances([1.0, -1.0, 1.0, -1.0], [0.5, -0.5, 0.5, -0.5])).tolist()
    [[2.0]]
    """
    _require_related(command_x)
    return solved(command_x.xa, command_x.xx).mT


def _require_related(command_x: Covariances) -> None:
    uu, ux, xx = command_x.xx, command_x.xa, command_x.aa
    if ux.shape[-2] != ux.shape[-1]:
        raise InvalidData(
            f"command has {ux.shape[-2]} rows and x has {ux.shape[-1]}; each excited joint needs "
            "one"
        )
    scale = np.sqrt(_diagonals(uu)[..., :, None] * _diagonals(xx)[..., None, :])
    related = scale.all()
    if related and ux.shape[-1] == 1:
        related = (np.abs(ux) >= UNRELATED * scale).all()
    elif related:
        related = (np.linalg.svd(ux / scale, compute_uv=False)[..., -1] >= UNRELATED).all()
    if not related:
        raise InvalidData("x does not follow the command; the command cannot serve as instrument")
