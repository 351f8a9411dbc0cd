"""Excitation proposed in a pose within torque and band, and its sensitivity to each fault.

How well one record would show each fault: how far seats open, and the smallest gap seen.

A seat that a record drives with the rms force F, that gravity loads with W and that would move by
x rms if it floated, loses about min(1, (F / 0.6 W)²) · min(1, gap / 4 x) of its transmission (as
in `loose_env.diagnosis.experiment_design`). What that changes of the tool's motion, in
standard deviations of what sensors, record length and model leave open, says whether it is seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loose_env.arms import Arm, LinearArm, LinearPose
from loose_env.diagnosis import Proposal, SeatFeatures, predict_seats, propose_excitation
from loose_env.inference import whitener
from loose_env.instrument.result import NextMeasurement
from loose_env.instrument.settings.measurement import NextSettings
from loose_env.instrument.settings.thresholds import (
    DETECTABLE_Z,
    FLOATING_CLEARANCE,
    OPENING_FORCE,
    REPEATABILITY,
)
from loose_env.typing import Array


def torque_of(proposal: Proposal, joint: int, settings: NextSettings) -> Array:
    """Rms torque of every joint for the proposed level, within the tool limit (n,).

    All zero where the joint cannot move the tool.
    """
    excitation = proposal.excitations[joint]
    if excitation is None:
        return np.zeros(len(proposal.excitations))
    share = min(1.0, settings.most_tool / max(float(proposal.levels[joint]), 1e-12))
    return share * np.array(excitation.torque_rms)


def limited(arm: Arm, linear: LinearArm, settings: NextSettings) -> tuple[Arm, LinearArm]:
    """Take the arm and its linear form with the torque and the band that settings allow."""
    torque = tuple(settings.torque_share * t for t in arm.torque_limits)
    less = replace(arm, torque_limits=torque, band=settings.band_of(arm.band))
    return less, linear.variant(less)


def proposed(arm: Arm, pose: Array, settings: NextSettings) -> Proposal:
    """Propose what to play in a pose, in the band that settings allow."""
    found = propose_excitation(arm, pose, gap=settings.gap_mm * 1e-3, duration=settings.seconds)
    low = found.band[0] if settings.band_low is None else max(found.band[0], settings.band_low)
    allowed = settings.allowed_hz if settings.band_high is None else settings.band_high
    high = min(found.band[1], allowed)
    if (low, high) == found.band:
        return found
    if not low < high:  # modes ask for a band that is not allowed at all
        low, high = arm.band
    # As much torque at each frequency as before.
    share = np.sqrt((high - low) / (found.band[1] - found.band[0]))
    played = tuple(
        None
        if one is None
        else replace(one, torque_rms=tuple(share * t for t in one.torque_rms), band=(low, high))
        for one in found.excitations
    )
    return replace(found, band=(low, high), levels=share * found.levels, excitations=played)


def unlimited(
    arm: Arm,
    linear: LinearArm,
    pose: Array,
    joints: Sequence[int],
    chosen: NextMeasurement,
    settings: NextSettings,
) -> tuple[float, ...]:
    """Rms torque of a measurement's joints without limits of motion [N·m, N].

    A measurement keeps to the limits in its whole band; in a narrower one more torque does.
    """
    proposal = proposed(limited(arm, linear, settings)[0], pose, settings)
    if not np.allclose(proposal.band, chosen.band_hz):
        return chosen.torques
    return tuple(
        max(torque, float(torque_of(proposal, j, settings)[j]))
        for j, torque in zip(joints, chosen.torques, strict=True)
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Sensitivity:
    """Expected change of one record by a seat at each of P locations, slides before plays.

    Places are those of `SeatFeatures`.
    """

    opens: Array
    """Share of the seat's motion that gravity's load on it allows, 0 shut to 1 free (P,)."""
    travel: Array
    """Rms motion of the floating seat [m; rad for a hinge's play] (P,)."""
    load: Array
    """Force or torque that gravity puts on the seat [N, N·m] (P,)."""
    by_noise: Array
    """Change of a freely floating seat, in standard deviations of the sensors' noise alone (P,)."""
    by_reference: Array
    """Change of a freely floating seat, in standard deviations of what noise and repeating leave
    beside a healthy reference of the same arm (P,)."""
    by_model: Array
    """The same with the errors that a nominal model has (P,)."""

    def lost(self, gap: Array | float) -> Array:
        """Share of its transmission that each seat of a travel loses (P,)."""
        floats = np.minimum(
            1.0, np.asarray(gap) / np.maximum(FLOATING_CLEARANCE * self.travel, 1e-15)
        )
        return np.asarray(self.opens * floats)

    def smallest_gap(self, *, reference: bool) -> Array:
        """Smallest travel that shows; infinite where none does [m; rad] (P,)."""
        change = self.by_reference if reference else self.by_model
        share = DETECTABLE_Z / np.maximum(change * self.opens, 1e-12)
        return np.where(share <= 1.0, share * FLOATING_CLEARANCE * self.travel, np.inf)


def tool_noise(features: SeatFeatures) -> float:
    """Noise of one axis of the tool accelerometer in the band, rms [m/s²]."""
    return float(features.floor.tool)


def sensitivity(features: SeatFeatures, pose: Array, torque: Array, seconds: float) -> Sensitivity:
    """Work out what one record would show."""
    arm = features.linear.arm
    at = features.linear.at(pose)
    excited = torque > 0
    on = np.flatnonzero(excited)
    m, d = len(on), len(arm.axes)
    noise = np.concatenate([features.floor.joints(arm)[on], np.full(d, features.floor.tool)]) ** 2
    seats = predict_seats(at, torque, features.directions, noise)
    x = seats.in_step[:m]
    b = seats.in_step[m:] @ np.linalg.inv(x)
    away = np.concatenate([-b, np.eye(d)], axis=1)
    samples = 2 * (arm.band[1] - arm.band[0]) * seconds
    sensed = away @ np.diag(noise) @ away.T
    change = features.open_change(seats)
    total = float(np.trace(seats.in_step[m:] @ seats.in_step[m:].T))
    repeated = np.kron(sensed, np.eye(m)) / samples + REPEATABILITY**2 * total * np.eye(d * m)
    own = whitener(repeated)
    noisy = whitener(np.kron(sensed, np.eye(m)) / samples)
    residual = away @ seats.rest @ away.T
    by_model = whitener(features.covariance(pose, excited, b, residual, x, seconds))
    opens = np.minimum(1.0, (seats.force / np.maximum(OPENING_FORCE * seats.load, 1e-12)) ** 2)
    return Sensitivity(
        opens=opens,
        travel=_travel(at, excited, torque[on], features.directions),
        load=seats.load,
        by_noise=np.linalg.norm(change @ noisy.T, axis=1),
        by_reference=np.linalg.norm(change @ own.T, axis=1),
        by_model=np.linalg.norm(change @ by_model.T, axis=1),
    )


def _travel(at: LinearPose, excited: NDArray[np.bool_], torque: Array, directions: Array) -> Array:
    """Rms motion of every floating seat (P,)."""
    answer, opened = at.response(excited), at.open_response(excited)
    power = (2 * np.pi * answer.frequency) ** 4
    force = np.einsum("kism,as->kiam", answer.slide, directions) * torque
    mass = np.einsum("kisr,as,ar->kia", opened.mass_slide, directions, directions)
    slide = np.sum(np.abs(force / mass[..., None]) ** 2, axis=-1) / power[:, None, None]
    turn = np.abs(answer.hinge * torque / opened.inertia_hinge[..., None]) ** 2
    play = np.sum(turn, axis=-1) / power[:, None]
    return np.asarray(np.sqrt(np.concatenate([slide.mean(0).ravel(), play.mean(0)])))
