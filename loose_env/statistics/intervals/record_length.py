"""Standard deviation of a direction, and the record length required for it."""

import math

import numpy as np
from numpy.typing import ArrayLike

from loose_env.errors import InvalidSetting
from loose_env.statistics._checks import as_record, require_rate
from loose_env.statistics.records.covariance import centred, covariances, planar_excitation
from loose_env.statistics.sampling.effective_samples import effective_samples


def direction_sd(x: ArrayLike, a: ArrayLike, rate: float) -> float:
    """Standard deviation of the direction of lowest correlation, in closed form.

    sd = sd(u) sd(x) / (|c| sqrt(N_eff)), with u the tool acceleration along that direction,
    c = cov(x, a) and N_eff from `effective_samples`. For small angles, and for u unrelated to x,
    not merely uncorrelated: where the strength of u follows x, as the motion in a gap does, the
    scatter can be twice this, and `direction_interval` says so.

    Parameters
    ----------
    x : array, shape (N,)
        Acceleration of the excited joint, rad/s^2.
    a : array, shape (2, N)
        Tool acceleration in the tool frame, m/s^2.
    rate : float
        Sampling rate, Hz. It cancels: time and spectra scale against each other.

    Returns
    -------
    float
        Standard deviation, rad.

    Raises
    ------
    InvalidData
        If the record or the rate cannot be used.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> x, noise = rng.standard_normal(1000), rng.standard_normal((2, 1000))
    >>> bool(abs(direction_sd(x, np.stack((x, 0 * x)) + noise, 1000.0) - 1000**-0.5) < 0.005)
    True
    """
    require_rate(rate)
    cov = covariances(x, a)
    c = planar_excitation(cov)
    size = float(np.hypot(c[0], c[1]))
    if size == 0.0:
        return math.inf
    tool = centred(a)
    u = (c[0] * tool[1] - c[1] * tool[0]) / size
    sd_u = math.sqrt(float(np.einsum("n,n", u, u)) / cov.count)
    if sd_u <= 1e-12 * math.sqrt(float(np.trace(cov.aa))):
        return 0.0
    sd_x = math.sqrt(float(cov.xx[0, 0]))
    return sd_u * sd_x / (size * math.sqrt(effective_samples(as_record(x, "x")[0], u)))


def record_length_for(sd_wanted: float, x: ArrayLike, a: ArrayLike, rate: float) -> float:
    """Record length required for a given standard deviation of the direction.

    `direction_sd` of a trial record, inverted: scatter falls with the root of time.

    Parameters
    ----------
    sd_wanted : float
        Standard deviation wanted, rad.
    x, a, rate
        Trial record at the level and in the pose meant, as in `direction_sd`.

    Returns
    -------
    float
        Length, s.

    Raises
    ------
    InvalidSetting
        If `sd_wanted` is not above zero.
    InvalidData
        If the record or the rate cannot be used.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> x, noise = rng.standard_normal(1000), rng.standard_normal((2, 1000))
    >>> a = np.stack((x, 0 * x)) + noise
    >>> round(record_length_for(0.5 * direction_sd(x, a, 1000.0), x, a, 1000.0), 6)
    4.0
    """
    if not (math.isfinite(sd_wanted) and sd_wanted > 0.0):
        raise InvalidSetting(f"sd_wanted is {sd_wanted} rad; it must be finite and above zero")
    seconds = np.shape(x)[-1] / rate
    return float(seconds * (direction_sd(x, a, rate) / sd_wanted) ** 2)
