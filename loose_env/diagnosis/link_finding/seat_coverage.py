"""Share of the loose seats that records would have opened: how far "nothing seen" goes."""

from __future__ import annotations

import numpy as np

from loose_env.arms import LinearArm
from loose_env.diagnosis.likelihood.opening_table import OpeningTable, shipped_table
from loose_env.diagnosis.likelihood.record_likelihood import OPENINGS
from loose_env.excitation import SeatDrive, SeatReference, at_levels
from loose_env.statistics import axes_grid
from loose_env.typing import Array

__all__ = ["SeatCoverage"]

_AXES = {2: 12, 3: 40}
"""Sliding directions that stand for all of a link, by dimension."""
_STEPS = 7
"""Frictions across their range."""
_SHOWS = 0.08
"""Opening, toward either side, from which a seat shows: that of the first node beside shut [1]."""


class SeatCoverage:
    """Probability that a record shows each seat, if that is the loose one.

    A seat shows where it opens. How far it does was measured on simulated
    arms (`OpeningTable`): it follows from the rms force that drives it, gravity's load and its
    friction. The friction is known by its range alone, log-uniform over the drive of the strongest
    excitation, and is the same in every record.

    Parameters
    ----------
    linear : LinearArm
        The nominal arm.
    friction : (float, float)
        Range of the friction over the seat's drive by the top level [1].
    over : {"median", "best"}
        Pose whose drive that is, see `loose_env.excitation.SeatDrive`.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> seats = SeatCoverage(LinearArm(planar(2)), (0.02, 1.0))
    >>> weak, strong = (seats.shown(np.array([0.0, 1.0]), np.full(2, a)) for a in (0.5, 4.0))
    >>> weak.shape, bool(weak.mean() < strong.mean())
    ((26, 7), True)
    """

    def __init__(
        self, linear: LinearArm, friction: tuple[float, float], over: SeatReference = "median"
    ) -> None:
        arm, table = linear.arm, shipped_table()
        self.linear = linear
        self.axes = axes_grid(_AXES[len(arm.axes)], len(arm.axes))
        """Sliding directions in a link's frame (A, d)."""
        drive = SeatDrive(linear, over=over)
        slides = [drive.slide(link, tuple(u)) for link in range(1, arm.n + 1) for u in self.axes]
        hinges = [drive.hinge(joint) for joint in range(1, arm.n + 1)]
        top = np.array([*slides, *hinges])
        self._friction = np.maximum(top, 1e-9 * top.max())[:, None] * np.geomspace(
            *friction, _STEPS
        )
        wide = np.abs(OPENINGS) > _SHOWS - 0.01
        self._shows = [part[:, :, wide].sum(axis=(2, 3)).ravel() for part in
                       (table.slide, table.hinge)]  # fmt: skip

    @property
    def frictions(self) -> int:
        """Number of frictions, F."""
        return int(self._friction.shape[1])

    def shown(self, pose: Array, levels: Array) -> Array:
        """Probability that a record shows each seat, at each of its possible frictions.

        Parameters
        ----------
        pose : ndarray (n,)
            Pose of the record [rad or m].
        levels : ndarray (n,)
            Rms tool acceleration from each joint [m/s²]; 0 holds it.

        Returns
        -------
        ndarray (n A + n, F)
            Of each link's sliding directions, then of each joint's play [1].
        """
        at, d = self.linear.at(pose), self.axes.shape[1]
        excitation, _ = at_levels(at, levels, duration=1.0)
        on = levels > 0
        torque = np.asarray(excitation.torque_rms)[on]
        answer = at.response(on)
        slide = answer.slide[:, :, :d] * torque
        power = np.einsum("kism,kitm->ist", slide, slide.conj(), optimize=True).real / len(slide)
        slides = np.einsum("as,ist,at->ia", self.axes, power, self.axes, optimize=True)
        hinges = np.mean(np.sum(np.abs(answer.hinge * torque) ** 2, axis=-1), axis=0)
        force = np.sqrt(np.concatenate([slides.ravel(), hinges]))[:, None]
        loads = np.abs(at.seat_load[:, :d] @ self.axes.T)
        load = np.concatenate([loads.ravel(), np.abs(at.load[self.linear.hinge_dofs])])[:, None]
        found = np.zeros(self._friction.shape)
        first = slides.size
        for node, weight in OpeningTable.nodes(force, self._friction, load):
            found[:first] += weight[:first] * self._shows[0][node[:first]]
            found[first:] += weight[first:] * self._shows[1][node[first:]]
        return found
