"""What to play in a pose, within the torque and the band that settings allow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from loose_env.arms.arm import Arm
from loose_env.arms.linear import LinearArm
from loose_env.diagnosis.records.excitation_design import Proposal, propose_excitation
from loose_env.instrument.next_settings import NextSettings

__all__ = ["limited", "proposed", "torque_of"]

Array = NDArray[np.float64]


def torque_of(proposal: Proposal, joint: int, settings: NextSettings) -> Array:
    """Rms torque of every joint that shakes one of them as proposed, the tool not too hard (n,).

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
