"""Moments of one record: covariances, transmission, apparent inertia, skewness, kurtosis.

Sums are divided by the number of samples.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from loose_env.errors import InvalidData
from loose_env.statistics._checks import as_record, as_records, as_samples
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

    x_a: Covariances
    """Of the joint accelerations with the tool acceleration."""
    command_x: Covariances
    """Of the command with the joint accelerations."""
    command_a: Covariances
    """Of the command with the tool acceleration."""


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
    joint = _Joint(x=as_record(x, "x"), a=as_record(a, "a"))
    joint.require_every_row("x")
    joint.require_one_row("a")
    return joint.between("x", "a")


def record_covariances(command: ArrayLike, x: ArrayLike, a: ArrayLike) -> RecordCovariances:
    """Compute all covariances of a record and its command, in one pass.

    Parameters
    ----------
    command, x, a : array, shape (N,) or (..., k, N)
        Commanded torques of the excited joints, N m; their accelerations, rad/s^2; tool
        acceleration in the tool frame, m/s^2. Axes in front are those of several records.

    Returns
    -------
    RecordCovariances
        The same as `covariances` of each pair, of every record, with the same errors.

    Examples
    --------
    >>> u = [1.0, -1.0, 1.0, -1.0]
    >>> cov = record_covariances(u, [3.0, -3.0, 3.0, -3.0], [u, u])
    >>> cov.command_x.xa.tolist(), cov.command_a.xa.tolist(), cov.x_a.xa.tolist()
    ([[3.0]], [[1.0, 1.0]], [[3.0, 3.0]])
    """
    joint = _Joint(command=command, x=x, a=a)
    joint.require_every_row("command")
    joint.require_every_row("x")
    joint.require_one_row("a")
    return RecordCovariances(
        x_a=joint.between("x", "a"),
        command_x=joint.between("command", "x"),
        command_a=joint.between("command", "a"),
    )


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
    dependent = "the rows of x depend on each other; each joint needs an excitation of its own"
    try:
        factor = np.asarray(np.linalg.cholesky(xx), dtype=np.float64)
    except np.linalg.LinAlgError as error:
        raise InvalidData(dependent) from error
    # The square of a pivot is what of a row's variance the rows above leave unexplained.
    if (_diagonals(factor) ** 2 < STILL * _diagonals(xx)).any():
        raise InvalidData(dependent)
    return factor


def _diagonals(matrices: Array) -> Array:
    """Diagonals (..., k) of matrices (..., k, k)."""
    return np.asarray(np.diagonal(matrices, axis1=-2, axis2=-1))


class _Joint:
    """Covariance of all signals of a record with each other, or of each of several records."""

    def __init__(self, **signals: ArrayLike) -> None:
        records = {name: as_records(signal, name) for name, signal in signals.items()}
        lengths = {name: record.shape[-1] for name, record in records.items()}
        if len(set(lengths.values())) > 1:
            raise InvalidData(f"the numbers of samples are {lengths}; they must be equal")
        joined = np.concatenate(list(records.values()), axis=-2)
        self.count = joined.shape[-1]
        with np.errstate(invalid="ignore", over="ignore"):
            means = joined.mean(axis=-1, keepdims=True)
            joined -= means
            # einsum sums in one fixed order, whatever the number of threads or records.
            self.full = np.einsum("...in,...jn->...ij", joined, joined) / self.count
        if not np.isfinite(self.full).all():
            raise InvalidData(f"{' or '.join(records)} holds NaN, infinite or too large values")
        # What is left of a constant after its mean is removed is rounding.
        self.moving = _diagonals(self.full) > (1e-15 * means[..., 0]) ** 2
        self.rows: dict[str, slice] = {}
        start = 0
        for name, record in records.items():
            self.rows[name] = slice(start, start + record.shape[-2])
            start += record.shape[-2]

    def require_every_row(self, name: str) -> None:
        moving = self.moving[..., self.rows[name]]
        if not moving.all():
            row = int(np.argwhere(~moving)[0, -1])
            raise InvalidData(f"{name} is constant in row {row}; it must vary")

    def require_one_row(self, name: str) -> None:
        if not self.moving[..., self.rows[name]].any(axis=-1).all():
            raise InvalidData(f"{name} is constant; it must vary in one row at least")

    def between(self, x: str, a: str) -> Covariances:
        p, q, full = self.rows[x], self.rows[a], self.full
        return Covariances(full[..., p, p], full[..., p, q], full[..., q, q], self.count)


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
        means = record.mean(axis=-1, keepdims=True)
        off = record - means
        sd = np.sqrt(np.einsum("...n,...n->...", off, off) / record.shape[-1])[..., None]
    if not np.isfinite(sd).all():
        raise InvalidData("a holds NaN, infinite or too large values")
    if (sd <= ROUNDING * np.abs(means)).any():
        raise InvalidData("a is constant in a component asked for; it must vary")
    z = off / sd
    square = z * z
    third = np.einsum("...n,...n->...", square, z) / z.shape[-1]
    fourth = np.einsum("...n,...n->...", square, square) / z.shape[-1] - 3.0
    return np.asarray(third), np.asarray(fourth)


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
    if cov.xx.shape[-1] == 1:
        return (cov.xa / cov.xx).mT
    factor = excitation_factor(cov.xx)
    b = np.linalg.solve(factor.mT, np.linalg.solve(factor, cov.xa)).mT
    return np.asarray(b, dtype=np.float64)


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
    return np.asarray(np.linalg.solve(command_x.xa, command_a.xa).mT, dtype=np.float64)


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
    return np.asarray(np.linalg.solve(command_x.xa, command_x.xx).mT, dtype=np.float64)


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
