"""What of a loose seat's motion follows no command, as several sensors see it.

A seat that rattles or sticks and slips moves along its direction out of step with the commands.
That motion reaches every sensor beyond the seat by the same vector: it adds a covariance of rank
one to what the sensors show beside the joints' motion.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

__all__ = ["LooseMotion", "loose_record"]

Array = NDArray[np.float64]

_POWER_ERROR = 0.35
"""Relative error of residual powers that sampling does not explain [1]."""
_SHARES = np.concatenate([[0.0], np.geomspace(1e-5, 1.0, 11)])
"""Powers of loose motion that are tried, over that of a freely floating seat [1]."""


def loose_record(
    rest: Array, healthy: Array, column: Array, error: Array, samples: float
) -> tuple[Array, Array, float]:
    """Reduce one record to each link's products with its pattern.

    Parameters
    ----------
    rest : ndarray (D, D)
        Covariance of what follows no joint [m²/s⁴].
    healthy : ndarray (D, D)
        The same of the healthy arm.
    column : ndarray (D, n, A)
        What a unit acceleration of each link's seat adds to each row.
    error : ndarray (n,)
        Relative error of each link's pattern [1].
    samples : float
        Independent samples of the record.

    Returns
    -------
    a, c : ndarray (n, A, A)
        Pattern against pattern and rest against pattern, weighted by the healthy covariance.
    degrees : float
        Degrees of freedom of the covariance.
    """
    d = len(column)
    size = float(np.trace(rest)) / d
    wide = healthy + (error**2)[:, None, None] * size * np.eye(d)
    weighted = np.linalg.solve(wide, column.transpose(1, 0, 2))  # (n, D, A)
    across = weighted.transpose(0, 2, 1)
    degrees = 2 / (2 / samples + _POWER_ERROR**2)
    a = across @ column.transpose(1, 0, 2)
    return a, across @ rest @ weighted, float(degrees)


class LooseMotion:
    """Log-likelihood of loose motion along directions, against none (a Wishart density).

    The power of the motion in each record is unknown, equally likely in every decade, and summed
    over in closed form: it is of rank one.

    Parameters
    ----------
    records : sequence of (a, c, degrees)
        From `loose_record`.
    floating : ndarray (records, n)
        Power of a freely floating seat's acceleration [m²/s⁴].

    Examples
    --------
    >>> a = np.eye(2)[None]
    >>> motion = LooseMotion([(a, np.diag([9.0, 1.0])[None], 14.0)], np.array([[100.0]]))
    >>> found = motion(np.eye(2)[None])
    >>> bool(found[0, 0] > 10), bool(found[0, 1] < 0)
    (True, True)
    """

    def __init__(self, records: Sequence[tuple[Array, Array, float]], floating: Array) -> None:
        self._a = np.stack([r[0] for r in records], axis=1)  # (n, R, A, A)
        self._c = np.stack([r[1] for r in records], axis=1)
        self._degrees = np.array([r[2] for r in records])
        self._power = floating.T[:, None, :, None] * _SHARES  # (n, 1, R, Q)

    def __call__(self, u: Array) -> Array:
        """For directions u (n, U, A) of each link (n, U)."""
        seen = u[:, :, None, None, :]
        turned = u[:, :, None, :, None]
        a = (seen @ self._a[:, None] @ turned)[..., 0]  # (n, U, R, 1)
        c = (seen @ self._c[:, None] @ turned)[..., 0]
        wider = 1 + self._power * a
        gain = 0.5 * self._degrees[:, None] * (self._power * c / wider - np.log(wider))
        most = gain.max(axis=3, keepdims=True)
        total = most[..., 0] + np.log(np.mean(np.exp(gain - most), axis=3))
        return np.asarray(total.sum(axis=2))
