"""How well a measured covariance fits many expected ones: the Wishart density in closed form."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from loose_env.errors import InvalidData

__all__ = ["wishart_fit"]

Array = NDArray[np.float64]
_TINY = 1e-300


def wishart_fit(found: Array, fixed: Array, added: Array, amounts: Array, degrees: float) -> Array:
    """Log-density of a covariance, less its highest value: 0 where expectation meets it.

    The expected covariance is ``fixed + amount * added``. Its determinant, and the trace of its
    inverse times the measured one, are ratios of polynomials in the amount, so the cofactors are
    worked out once for all amounts. Without rounding this is
    ``-degrees / 2 (tr(E⁻¹ F) - d - ln det(E⁻¹ F))``, the log-density of Wishart's distribution
    of ``degrees * F`` with scale E up to a constant.

    Parameters
    ----------
    found : ndarray (d, d)
        Covariance measured, positive definite; d is 2 or 3.
    fixed : ndarray (..., d, d)
        Constant part of the covariances expected, symmetric.
    added : ndarray (..., d, d)
        Part that comes in an unknown amount, symmetric; of any shape that broadcasts.
    amounts : ndarray (Q,)
        Amounts, zero or more.
    degrees : float
        Degrees of freedom.

    Returns
    -------
    ndarray (..., Q)

    Raises
    ------
    InvalidData
        If d is not 2 or 3.

    Examples
    --------
    >>> import numpy as np
    >>> wishart_fit(2 * np.eye(2), np.eye(2), np.eye(2), np.array([0.0, 1.0]), 10.0).round(2)
    array([-3.07,  0.  ])
    """
    d = len(found)
    if d not in (2, 3):
        raise InvalidData(f"the covariance must be 2 x 2 or 3 x 3, got {found.shape}")
    of_fixed, of_added = _cofactors(fixed), _cofactors(added)
    if d == 2:  # det(A + q B) = det A + q tr(adj A B) + q² det B
        determinant = [_det(fixed, of_fixed), _dot(of_fixed, added), _det(added, of_added)]
        numerator = [_dot(of_fixed, found), _dot(of_added, found)]
    else:
        determinant = [
            _det(fixed, of_fixed),
            _dot(of_fixed, added),
            _dot(fixed, of_added),
            _det(added, of_added),
        ]
        between = _cofactors(fixed + added) - of_fixed - of_added
        numerator = [_dot(of_fixed, found), _dot(between, found), _dot(of_added, found)]
    expected = np.maximum(_polynomial(determinant, amounts), _TINY)
    trace = _polynomial(numerator, amounts) / expected
    measured = np.log(max(np.linalg.det(found), _TINY))
    return np.asarray(-0.5 * degrees * (trace - d - measured + np.log(expected)))


def _polynomial(coefficients: list[Array], at: Array) -> Array:
    """Values of polynomials, lowest coefficient first, at all points (..., Q)."""
    stacked = np.stack(np.broadcast_arrays(*coefficients), axis=-1)
    return np.asarray(stacked @ at ** np.arange(len(coefficients))[:, None])


def _dot(a: Array, b: Array) -> Array:
    """Trace of the product of symmetric matrices (...)."""
    d = a.shape[-1]
    total = sum(a[..., i, i] * b[..., i, i] for i in range(d))
    mixed = sum(a[..., i, j] * b[..., i, j] for i in range(d) for j in range(i))
    return np.asarray(total + 2 * mixed)


def _det(matrix: Array, cofactors: Array) -> Array:
    """Determinant, along the first row (...)."""
    return np.asarray(sum(matrix[..., 0, i] * cofactors[..., 0, i] for i in range(len(matrix.T))))


def _cofactors(m: Array) -> Array:
    """Cofactors of symmetric 2 x 2 or 3 x 3 matrices (..., d, d)."""
    found = np.empty_like(m)
    if m.shape[-1] == 2:
        found[..., 0, 0], found[..., 1, 1] = m[..., 1, 1], m[..., 0, 0]
        found[..., 0, 1] = found[..., 1, 0] = -m[..., 0, 1]
        return found
    for i in range(3):
        for j in range(i + 1):
            a, b, c, e = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
            found[..., i, j] = m[..., a, c] * m[..., b, e] - m[..., a, e] * m[..., b, c]
            found[..., j, i] = found[..., i, j]
    return found
