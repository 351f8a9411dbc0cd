"""Efficient information of an outer product's estimate about the angle of its axis."""

import numpy as np

from loose_env.typing import Array


def angle_information(precision: Array, axes: Array, drives: Array) -> Array:
    """Least information about the angle of an axis u, where a matrix is u v.T and errors.

    Turning u by a small angle e towards a unit vector w across it adds e w v.T. What is left of
    that once v is fitted anew, weighed by the errors, is the information about the angle in that
    sense (the efficient information: Schur's complement over v); the least over all w counts.

    Parameters
    ----------
    precision : array, shape (d, m, d, m)
        Inverse covariance of the entries of the matrix.
    axes : array, shape (K, d)
        Unit vectors u.
    drives : array, shape (K, m)
        Best v for each of them.

    Returns
    -------
    array, shape (K,)
        Information, 1/rad^2. With errors of one variance in all entries it is v . v over it.

    References
    ----------
    van der Vaart, Asymptotic Statistics (1998), section 25.4.

    Examples
    --------
    >>> alike = np.eye(6).reshape(3, 2, 3, 2) / 0.1**2
    >>> angle_information(alike, np.eye(3)[:1], np.array([[3.0, 4.0]])).round(6).tolist()
    [2500.0]
    """
    d, m = precision.shape[:2]
    count, size = len(axes), d * m
    turned = np.linalg.svd(axes[:, None])[2][:, 1:]  # unit vectors across each axis
    along = np.einsum("ki,jn->kjin", axes, np.eye(m)).reshape(count, m, size)
    across = np.einsum("kai,kn->kain", turned, drives).reshape(count, d - 1, size)
    matrix = precision.reshape(size, size)
    weighed = across @ matrix
    own = weighed @ across.transpose(0, 2, 1)
    mixed = weighed @ along.transpose(0, 2, 1)
    fitted = along @ matrix @ along.transpose(0, 2, 1)
    left = own - mixed @ np.linalg.solve(fitted, mixed.transpose(0, 2, 1))
    return np.asarray(np.maximum(np.linalg.eigvalsh(left)[:, 0], 0.0))
