"""Residual of one record's change by the best seat, and its reduction by a second.

The change of transmission is set against what one loose seat makes of it. Errors of model and
sampling are known to first order only, and along some directions that leaves next to nothing:
there errors of second order, the steps between the directions that are tried and the seat's own
nonlinearity would look like a change. So each is given room of its own, in shares of the motion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from loose_env.diagnosis.learned.transmission_change import TransmissionChange
from loose_env.typing import Array

__all__ = ["ResidualChange", "residual_change"]


MODEL_SHARE = 0.01
"""Errors beyond the first order, as a share of the arm's own in-step motion [1]."""
SEAT_SHARE = 0.05
"""Errors of a seat's motion, as a share of it [1]: half the step between 24 directions is 3.75
degrees, 6.5 % of the motion at most, 3.8 % rms."""
_WIDEST = (-0.5, 1.5)  # how far a seat opens: below none or above all of it by errors only
_TURNS = 2  # the room of a seat's motion depends on how far it opens, which depends on the room


@dataclass(frozen=True, kw_only=True, eq=False)
class ResidualChange:
    """One record's change under every location."""

    healthy: float
    """chi² of the change on a healthy arm."""
    residual: Array
    """Residual chi² of each location (P,)."""
    explained: Array
    """chi² explained by each location (P,)."""
    opening: Array
    """Fitted opening of each location, 1: floats freely (P,)."""
    measured: Array
    """The change along uncorrelated directions [m/s²] (K,)."""
    open: Array
    """The same of each location that floats freely (P, K)."""
    variance: Array
    """Variance along them for each location [m²/s⁴] (P, K)."""

    def second(self, first: int) -> Array:
        """Decrease of the log residual by a second seat, by location (P,).

        Parameters
        ----------
        first : int
            The location of the first.
        """
        sd = np.sqrt(self.variance[first])
        along, others = self.open[first] / sd, self.open / sd
        rest = self.measured / sd - self.opening[first] * along
        length = float(np.linalg.norm(along))
        along = along / length if length > 0 else along
        # The first may open otherwise beside a second one: only what lies across it counts.
        rest = rest - (rest @ along) * along
        others = others - np.outer(others @ along, along)
        left = float(rest @ rest)
        gain = (others @ rest) ** 2 / ((others**2).sum(1) + 1.0)
        return np.asarray(np.log((left + 1.0) / (np.maximum(left - gain, 0.0) + 1.0)))


def residual_change(change: TransmissionChange) -> ResidualChange:
    """Set one record's change against every location.

    Parameters
    ----------
    change : TransmissionChange
        The change with its covariance, and what each location would make of it.

    Examples
    --------
    >>> change = TransmissionChange(
    ...     measured=np.array([1.0, 0.5]),
    ...     open=np.array([[2.0, 0.0], [0.0, 2.0]]),
    ...     nominal=np.array([10.0, 0.0]),
    ...     covariance=0.01 * np.eye(2),
    ... )
    >>> found = residual_change(change)
    >>> found.opening.round(2).tolist(), (found.residual > 10).tolist()
    ([0.5, 0.25], [True, True])
    >>> found.second(0).round(1).tolist()
    [0.0, 2.7]
    """
    assert change.covariance is not None
    size, axes = np.linalg.eigh(change.covariance)
    measured, opened = axes.T @ change.measured, change.open @ axes
    count = len(measured)
    base = np.maximum(size, 0.0) + MODEL_SHARE**2 * float(change.nominal @ change.nominal) / count
    power = (change.open**2).sum(1) / count
    variance = np.broadcast_to(base, opened.shape)
    opening, visible = _opening(measured, opened, variance)
    for _ in range(_TURNS):
        variance = base + (SEAT_SHARE**2 * opening**2 * power)[:, None]
        opening, visible = _opening(measured, opened, variance)
    rest = measured - opening[:, None] * opened
    return ResidualChange(
        healthy=float((measured**2 / base).sum()),
        residual=(rest**2 / variance).sum(1) + opening**2,
        explained=opening**2 * visible,
        opening=opening,
        measured=measured,
        open=opened,
        variance=variance,
    )


def _opening(measured: Array, opened: Array, variance: Array) -> tuple[Array, Array]:
    """Fitted opening of each location, and the chi² of it floating freely (P,)."""
    visible = (opened**2 / variance).sum(1)
    opening = (opened * measured / variance).sum(1) / (visible + 1.0)
    return np.clip(opening, *_WIDEST), visible
