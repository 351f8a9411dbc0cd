"""Confidence intervals of a planar direction from one record."""

import math

import numpy as np
from numpy.typing import ArrayLike

from loose_env.errors import InvalidData
from loose_env.statistics._checks import as_floats
from loose_env.statistics.intervals.axis import DirectionInterval, Resampling, interval
from loose_env.statistics.records.covariance import centred, covariances, planar_excitation
from loose_env.statistics.tool_transmission.change import transmission_by_instrument_from
from loose_env.typing import Array


def direction_interval(
    x: ArrayLike,
    a: ArrayLike,
    rate: float,
    level: float = 0.95,
    *,
    rng: np.random.Generator | None = None,
    method: str = "block",
    resamples: int = 1000,
    block: float | None = None,
) -> DirectionInterval:
    """Compute the confidence interval of the direction of lowest correlation.

    Parameters
    ----------
    x : array, shape (N,)
        Acceleration of the excited joint, rad/s^2.
    a : array, shape (2, N)
        Tool acceleration in the tool frame, m/s^2.
    rate : float
        Sampling rate, Hz.
    level : float
        Confidence level, above 0 and below 1.
    rng : numpy.random.Generator, optional
        Where the blocks are drawn from; needed by the method "block" only.
    method : {"block", "hac"}
        "block": circular block bootstrap, percentiles of the axial deviations. "hac": the
        standard deviation by Newey and West, symmetric.
    resamples : int
        Number of bootstrap resamples.
    block : float, optional
        Length of a block, or of the memory summed by "hac", s. By default the rule of Politis and
        White decides from the record.

    Returns
    -------
    DirectionInterval
        Interval about the estimate; it covers nearly every axis when the record says nothing.

    Raises
    ------
    InvalidData
        If the record or the rate cannot be used.
    InvalidSetting
        If `level`, `resamples` or `block` is out of range, or "block" is given no `rng`.
    UnknownName
        If `method` is neither of the two.

    Notes
    -----
    In simulation, with 1200 samples at 1 kHz and a level of 0.95, the interval held the truth
    95 % of the time for white noise and for noise of 30 to 150 Hz, 92 % when the noise grows
    with the excitation as in a gap, and 87 % near a resonance with 2 % damping, where 20
    to 40 independent samples are left: there take a longer record.

    References
    ----------
    Politis and Romano (1992), circular blocks; Newey and West (1987).

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> x, noise = rng.standard_normal(1000), rng.standard_normal((2, 1000))
    >>> a = np.stack((x, 0 * x)) + noise
    >>> direction_interval(x, a, 1000.0, rng=rng).contains(np.pi / 2)
    True
    """
    how = Resampling(rate, level, rng, method, resamples, block)
    cov = covariances(x, a)
    c = planar_excitation(cov)
    if not c.any():
        raise InvalidData("x is uncorrelated with a in every direction; none is the lowest")
    joint, tool = centred(x), centred(a)
    across = c[0] * tool[1] - c[1] * tool[0]
    influence = joint[0] * across / float(np.sum(c * c))

    def axis(drawn: Array) -> Array:
        return np.arctan2(drawn[:, 0, 1], drawn[:, 0, 0]) + math.pi / 2

    return interval(joint, tool, influence, axis, how)


def change_direction_interval(
    x: ArrayLike,
    a: ArrayLike,
    rate: float,
    reference: ArrayLike,
    level: float = 0.95,
    *,
    command: ArrayLike | None = None,
    rng: np.random.Generator | None = None,
    method: str = "block",
    resamples: int = 1000,
    block: float | None = None,
) -> DirectionInterval:
    """Compute the confidence interval of the direction of a transmission change.

    The direction is that of `transmission_change` against a reference taken as exact; where the
    reference is itself measured, its scatter comes on top.

    Parameters
    ----------
    x : array, shape (N,) or (m, N)
        Accelerations of the excited joints, rad/s^2.
    a : array, shape (2, N)
        Tool acceleration in the tool frame, m/s^2.
    rate : float
        Sampling rate, Hz.
    reference : array, shape (2, m)
        Transmission of the healthy arm in the same pose, m/s^2 per rad/s^2.
    level, rng, method, resamples, block
        As in `direction_interval`.
    command : array, shape (N,) or (m, N), optional
        Commanded torques, N m: then the transmission is `transmission_by_instrument`.

    Returns
    -------
    DirectionInterval
        Interval about the estimate.

    Raises
    ------
    InvalidData, InvalidSetting, UnknownName
        As in `direction_interval`, and if the reference does not fit.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> x, noise = rng.standard_normal(1000), rng.standard_normal((2, 1000))
    >>> a = np.stack((x, 0.3 * x)) + 0.1 * noise
    >>> known = change_direction_interval(x, a, 1000.0, [[1.0], [0.0]], rng=rng)
    >>> known.contains(np.pi / 2)
    True
    """
    how = Resampling(rate, level, rng, method, resamples, block)
    instrument = x if command is None else command
    cov, cov_x = covariances(instrument, a), covariances(instrument, x)
    healthy = as_floats(reference, "reference")
    if len(cov.aa) != 2 or healthy.shape != (2, len(cov_x.aa)):
        raise InvalidData(
            f"a has {len(cov.aa)} rows, x has {len(cov_x.aa)} and reference has shape "
            f"{healthy.shape}; they must be 2, m and (2, m)"
        )
    b = transmission_by_instrument_from(cov_x, cov)
    z, joint, tool = centred(instrument), centred(x), centred(a)
    change = b - healthy
    influence = _turn_by_sample(
        change, b, as_floats(np.linalg.inv(cov_x.xa), "weight"), z, joint, tool
    )
    m = len(joint)

    def axis(drawn: Array) -> Array:
        found = np.linalg.solve(drawn[:, :, :m], drawn[:, :, m:]).transpose(0, 2, 1)
        return _leading_angle(found - healthy)

    return interval(z, np.concatenate((joint, tool)), influence, axis, how)


def _turn_by_sample(
    change: Array,
    b: Array,
    weight: Array,
    z: Array,
    x: Array,
    a: Array,
) -> Array:
    """Influence of each sample on the leading left singular vector [rad], up to sign."""
    left, values, right = np.linalg.svd(change)
    first, second = float(values[0]), float(values[1]) if len(values) == 2 else 0.0
    if first - second <= 1e-12 * float(np.linalg.norm(b)):
        raise InvalidData("the transmission changes alike in every direction, or not at all")
    residual = np.einsum("ji,jn->in", left, a - np.einsum("ij,jn->in", b, x))
    drive = np.einsum("ij,jn->in", right @ weight, z)
    # First-order perturbation of a singular vector, towards the second left vector.
    turn = first * residual[1] * drive[0]
    if second > 0.0:
        turn = turn + second * residual[0] * drive[1]
    return np.asarray(turn / (first**2 - second**2))


def _leading_angle(change: Array) -> Array:
    """Angle of the leading left singular vector of matrices of shape (R, 2, m), rad."""
    g = np.einsum("rik,rjk->rij", change, change)
    return np.asarray(0.5 * np.arctan2(2 * g[:, 0, 1], g[:, 0, 0] - g[:, 1, 1]))
