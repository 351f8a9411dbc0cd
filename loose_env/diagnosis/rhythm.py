"""Rhythm of short records: what rings above the excited band, and which seat must have knocked."""

from __future__ import annotations

import numpy as np

from loose_env.arms import LinearArm, LinearPose
from loose_env.diagnosis.experiment_design import SEAT_AXES
from loose_env.diagnosis.prediction import seat_drives
from loose_env.errors import InvalidSetting
from loose_env.excitation import SeatReference
from loose_env.rig import Records
from loose_env.statistics import acceleration_from_angle, axes_grid, bandpass, knocks, rung
from loose_env.typing import Array, IndexArray

_TOP, _NYQUIST = 1.3, 0.42
"""The top band: from this over the highest frequency excited, to this over the rate [1]."""
_FRICTIONS = (0.03, 0.1, 0.3, 0.9)
"""Frictions tried, over the seat's drive by the top level [1]."""
_GAPS = (0.03e-3, 0.06e-3, 0.15e-3, 0.35e-3)
"""Travels tried, at the tool [m]."""
_RING_S = 0.005
"""Time in which a knock's ringing decays to 1/e [s]."""
_EDGE = 10
"""Samples at either end that filters spoil."""
_SAMPLES, _VECTORS = 60.0, 4.0
"""Independent samples of an envelope, and directions of ringing, in a record [1]."""
_STRAY = 0.02
"""Least share of the ringing across the direction in which a knock throws the tool [1]."""


class KnockRhythm:
    """Says of every seat how well its knocks would explain what rang in a record.

    The record's own joint motion and the nominal masses give the load on each seat: the sliding
    directions of each link, then the play of each joint, in the order of `SeatCoverage` (P,). A
    mass between two stops under that load arrives at some times; the envelope of the top band is
    to rise then, along the direction in which the seat throws the tool.

    Parameters
    ----------
    linear : LinearArm
        The nominal arm.
    rate : float
        Samples a second [Hz].
    over : {"median", "best"}
        Pose whose drive friction is compared to, see `loose_env.excitation.SeatDrive`.

    Raises
    ------
    InvalidSetting
        If the rate leaves no band above the excitation.
    """

    def __init__(self, linear: LinearArm, rate: float, over: SeatReference = "median") -> None:
        arm = linear.arm
        self.linear, self.rate = linear, rate
        self._top = (_TOP * arm.band[1], _NYQUIST * rate)
        if self._top[0] >= self._top[1]:
            raise InvalidSetting(
                f"the rhythm is heard from {self._top[0]:g} Hz, {_TOP:g} times the highest "
                f"frequency excited, to {_NYQUIST:g} of the rate of {rate:g} Hz: give sensors of a "
                "higher rate"
            )
        self._axes = axes_grid(SEAT_AXES[len(arm.axes)], len(arm.axes))
        travel = np.ones(arm.n * len(self._axes) + arm.n)
        travel[-arm.n :] = np.where(arm.sliding, 1.0, 1.0 / arm.reach)
        tried = np.array([(f, g) for f in _FRICTIONS for g in _GAPS])
        self._friction = np.outer(tried[:, 0], seat_drives(linear, self._axes, over)).ravel()
        self._gap = np.outer(tried[:, 1], travel).ravel()
        self._tried = len(tried)

    def of(self, records: Records) -> tuple[Array, Array]:
        """Loudness (B,) and log likelihood of every seat (B, P) of B records.

        Loudness is the power of the top band over that of the excited one [1]; likelihoods are to a
        constant, and those of one arm's records add up.
        """
        found = [self._of(records, k) for k in range(len(records))]
        return np.array([one[0] for one in found]), np.array([one[1] for one in found])

    def _of(self, records: Records, k: int) -> tuple[float, Array]:
        at, driven = self.linear.at(records.pose[k]), np.flatnonzero(records.torque_rms[k])
        tool, kept = records.tool[k], slice(_EDGE, -_EDGE)
        top = bandpass(tool, self.rate, self._top)[:, kept]
        motion = bandpass(tool, self.rate, records.band)[:, kept]
        loads, mass, throws = self._loads(at, driven, records.encoder[k], records.band)
        period = records.duration
        rang = knocks(
            np.tile(loads, (self._tried, 1)),
            np.tile(mass, self._tried),
            self._gap,
            self._friction,
            period,
        )
        told = np.sqrt(rung(rang, _RING_S, period))[:, kept]
        heard = np.sqrt((top**2).sum(0))
        told -= told.mean(1, keepdims=True)
        heard -= heard.mean()
        size = np.linalg.norm(told, axis=1) * np.linalg.norm(heard)
        timing = np.clip(told @ heard / np.maximum(size, 1e-30), 0, 0.98)
        by_seat = timing.reshape(self._tried, -1).max(0)
        likelihood = -0.5 * _SAMPLES * np.log(1 - by_seat**2)
        likelihood += _VECTORS * _along(throws, top @ top.T)
        return float((top**2).sum() / (motion**2).sum()), likelihood

    def _loads(
        self, at: LinearPose, driven: IndexArray, encoder: Array, band: tuple[float, float]
    ) -> tuple[Array, Array, Array]:
        """Load of every seat (P, T), mass that flies free (P,), throw of the tool (P, d)."""
        linear, joints = self.linear, self.linear.joint_dofs[driven]
        moved = acceleration_from_angle(encoder[driven], self.rate, band)
        free = np.linalg.inv(at.inertia[np.ix_(joints, joints)])
        seats: list[tuple[IndexArray, Array]] = [(own, self._axes) for own in linear.slide_dofs]
        seats += [(np.array([dof]), np.ones((1, 1))) for dof in linear.hinge_dofs]
        loads, masses, throws = [], [], []
        for dofs, axes in seats:
            across = at.inertia[np.ix_(joints, dofs)]
            loads.append(axes @ (across.T @ moved + at.load[dofs][:, None]))
            stiff = at.inertia[np.ix_(dofs, dofs)] - across.T @ free @ across
            masses.append(np.einsum("as,st,at->a", axes, stiff, axes))
            thrown = at.jacobian[:, dofs] - at.jacobian[:, joints] @ free @ across
            throws.append(axes @ thrown.T)
        mass = np.maximum(np.concatenate(masses), 1e-4)
        return np.concatenate(loads), mass, np.concatenate(throws)


def _along(throws: Array, covariance: Array) -> Array:
    """Log likelihood of directions of throw (P,) by the covariance of what rang (d, d)."""
    d = len(covariance)
    unit = throws / np.maximum(np.linalg.norm(throws, axis=1, keepdims=True), 1e-12)
    share = np.einsum("pa,ab,pb->p", unit, covariance / np.trace(covariance), unit)
    share = np.clip(share, 1 / d, 1 - _STRAY)
    told = np.log(share) + (d - 1) * np.log((1 - share) / (d - 1)) + d * np.log(d)
    return np.asarray(-0.5 * told)
