"""Incoherent motion of a loose seat in several sensors.

A seat that rattles or sticks and slips moves along its direction out of step with the commands.
That motion reaches every sensor beyond the seat by the same vector: it adds a covariance of rank
one to what the sensors show beside the joints' motion.
"""

from __future__ import annotations

import numpy as np

from loose_env.typing import Array

__all__ = ["LooseMotion", "loose_records"]


_POWER_ERROR = 0.35
"""Relative error of residual powers that sampling does not explain [1]."""
_SHARES = np.concatenate([[0.0], np.geomspace(1e-5, 10.0, 31)])
"""Powers of loose motion that are tried, over that of a freely floating seat [1]."""


def loose_records(
    rest: Array, healthy: Array, column: Array, error: Array, missed: Array, samples: Array
) -> tuple[Array, Array, Array]:
    """Reduce the records of one pose to each link's products with its pattern.

    A pattern is off by the gains, leakage and mounting of the sensors and by what the model
    misses. These errors are the same in all samples of all records, so that no number of them
    averages out: in each sample they count as if their variance were larger by the number of
    samples that share them.

    Parameters
    ----------
    rest : ndarray (R, D, D)
        Covariance of what follows no joint in each record [m²/s⁴].
    healthy : ndarray (R, D, D)
        The same of the healthy arm.
    column : ndarray (R, D, n, A)
        Change of each row per acceleration of each link's seat.
    error : ndarray (R, D)
        Variance that the sensors' errors bring into each row beside any link's pattern [m²/s⁴].
    missed : ndarray (R, D)
        The same of what the model misses.
    samples : ndarray (R,)
        Independent samples of each record.

    Returns
    -------
    a, c : ndarray (n, R, A, A)
        Pattern against pattern and rest against pattern, weighted by the healthy covariance.
    degrees : ndarray (R,)
        Degrees of freedom of the covariances.
    """
    degrees = 2 / (2 / samples + _POWER_ERROR**2)
    whole = np.trace(rest, axis1=1, axis2=2)
    still = np.trace(healthy, axis1=1, axis2=2)
    shown = np.maximum(1 - still / np.maximum(whole, 1e-300), 0.0)
    count = float(degrees @ shown)  # a record that shows nothing of the seat shares no errors
    shared = count * error + degrees.sum() * missed
    wide = healthy + shared[:, :, None] * np.eye(rest.shape[1])
    pattern = column.transpose(2, 0, 1, 3)
    weighted = np.linalg.solve(wide, pattern)  # (n, R, D, A)
    across = weighted.swapaxes(2, 3)
    return across @ pattern, across @ rest @ weighted, degrees


class LooseMotion:
    """Log-likelihood of loose motion along directions, against none (a Wishart density).

    The power of the motion in each record is unknown, equally likely in every decade, and summed
    over in closed form: it is of rank one.

    Parameters
    ----------
    a, c, degrees : ndarray (n, R, A, A), (n, R, A, A), (R,)
        From `loose_records`.
    floating : ndarray (R, n)
        Power of a freely floating seat's acceleration [m²/s⁴].

    Examples
    --------
    >>> a, c = np.eye(2)[None, None], np.diag([9.0, 1.0])[None, None]
    >>> motion = LooseMotion(a, c, np.array([14.0]), np.array([[100.0]]))
    >>> found = motion(np.eye(2)[None])
    >>> bool(found[0, 0] > 10), bool(found[0, 1] < 0)
    (True, True)
    """

    def __init__(self, a: Array, c: Array, degrees: Array, floating: Array) -> None:
        self._a, self._c, self._degrees = a, c, degrees
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
