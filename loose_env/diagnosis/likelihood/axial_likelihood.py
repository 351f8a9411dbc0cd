"""Likelihood of a measured axis: Bingham distribution on the sphere.

An axis p measured with precision W (a matrix across p, so W p = 0) has, for the true axis m, the
density exp(-m' W m / 2) over its mean on the sphere: Bingham's distribution. Near p it is the
Gaussian of covariance W^-1 in the tangent plane; it does not mind the signs of p and m; and for
W = 0 it is uniform. Precisions carried into one frame add up, so the unknown direction is summed
out in closed form.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import i0e

from loose_env.errors import InvalidData
from loose_env.typing import Array

__all__ = ["log_mean_bingham", "precision_of"]


# Polar angles, equally weighted in their logarithm: the peak may be as narrow as a microradian.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(96)
_LOG_LOW, _LOG_HIGH = np.log(1e-7), np.log(np.pi / 2)
_POLAR = np.exp(0.5 * (_LOG_HIGH - _LOG_LOW) * (_NODES + 1) + _LOG_LOW)
_SHARE = 0.5 * (_LOG_HIGH - _LOG_LOW) * _WEIGHTS * _POLAR * np.sin(_POLAR)


def precision_of(direction: ArrayLike, uncertainty: ArrayLike) -> Array:
    """Precision matrix of a measured axis.

    Parameters
    ----------
    direction : array_like (d,)
        Measured axis; its sign and length do not matter.
    uncertainty : array_like, scalar or (d, d)
        Standard deviation of the angle in every direction across [rad], or covariance of the
        unit vector [rad²]; of the latter only what lies across the axis counts. Infinite where
        nothing is known.

    Returns
    -------
    ndarray (d, d)
        W [1/rad²], symmetric, without part along the axis.

    Raises
    ------
    InvalidData
        If the shapes do not fit, or the uncertainty is not positive.

    Examples
    --------
    >>> precision_of([1.0, 0.0], 0.1).round(6).tolist()
    [[0.0, 0.0], [0.0, 100.0]]
    """
    p, spread = np.asarray(direction, dtype=float), np.asarray(uncertainty, dtype=float)
    if p.ndim != 1 or len(p) not in (2, 3) or not np.isfinite(p).all() or not np.any(p):
        raise InvalidData(
            f"an axis is two or three finite numbers, not all zero; got {direction!r}"
        )
    p = p / np.linalg.norm(p)
    across = np.linalg.svd(p[None])[2][1:].T  # (d, d - 1)
    if np.isinf(spread).any() and not np.isnan(spread).any():
        return np.zeros((len(p), len(p)))  # nothing is known
    if spread.ndim == 0:
        if spread <= 0:
            raise InvalidData(f"a standard deviation is above zero, got {uncertainty!r} rad")
        spread = spread**2 * np.eye(len(p))
    if spread.shape != (len(p), len(p)) or np.isnan(spread).any():
        raise InvalidData(
            f"uncertainty is one number [rad] or a ({len(p)}, {len(p)}) covariance, got "
            f"{uncertainty!r}"
        )
    inside = across.T @ spread @ across
    if np.linalg.eigvalsh(inside)[0] <= 0:
        raise InvalidData(f"the uncertainty across the axis must be positive, got {uncertainty!r}")
    return np.asarray(across @ np.linalg.inv(inside) @ across.T)


def log_mean_bingham(matrix: ArrayLike) -> Array:
    """Logarithm of the mean of exp(-m' A m / 2) over all unit vectors m.

    Parameters
    ----------
    matrix : array_like (..., d, d)
        Symmetric, positive semidefinite A; d = 2 or 3.

    Returns
    -------
    ndarray (...)
        Logarithm of the mean; 0 for A = 0.

    References
    ----------
    Mardia and Jupp, Directional Statistics, section 9.4. In the plane it is a Bessel function;
    in space one angle is integrated in closed form and the other by Gauss-Legendre quadrature.

    Examples
    --------
    >>> log_mean_bingham(np.zeros((3, 3))).round(6).tolist()
    0.0
    >>> log_mean_bingham(np.diag([0.0, 200.0])).round(4).tolist()  # a narrow Gaussian, twice
    -2.8724
    """
    values = np.linalg.eigvalsh(np.asarray(matrix, dtype=float))
    low = values[..., 0]
    rest = values[..., 1:] - low[..., None]
    if rest.shape[-1] == 1:
        return np.asarray(np.log(i0e(rest[..., 0] / 4)) - low / 2)
    second, third = rest[..., 0, None], rest[..., 1, None]
    square = np.sin(_POLAR) ** 2
    # About the axis of the smallest eigenvalue; i0e carries exp(-|x|) of the azimuth's integral.
    integrand = np.exp(-0.5 * second * square) * i0e(0.25 * (third - second) * square)
    return np.asarray(np.log(integrand @ _SHARE) - low / 2)
