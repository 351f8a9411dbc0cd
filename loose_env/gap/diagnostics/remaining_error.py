"""Residual of the corrected model: its size, location, and torque by joint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from loose_env.gap.diagnostics.joint_torque_residual import JointMotion, joint_motion
from loose_env.gap.diagnostics.localisation import where_it_lives
from loose_env.gap.fitting.holdout_score import Judged
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_model import Machine
from loose_env.gap.output.evidence_schema import Location
from loose_env.gap.residuals.autocorrelation import largest
from loose_env.gap.residuals.residual_model import Comparison
from loose_env.gap.settings import (
    NOISE_RMS,
    UNEXPLAINED_Z,
)
from loose_env.typing import Array

__all__ = ["NOISE_RMS", "left_motions", "left_words"]


def left_words(
    base: Judged, best: Judged, location: Location, *, most: int = 3, struck: bool = False
) -> list[str]:
    """Describe the residual of the corrected model in sentences; none if it is noise.

    Parameters
    ----------
    base, best : Judged
        The nominal model, and the corrected one.
    location : Location
        Localised residual of the corrected model.
    most : int
        Maximum number of channels, and of joints.
    struck : bool
        Whether a part with chaotic impacts against its stops was identified.
    """
    before, after = base.held_rms, best.held_rms
    together = float(largest(best.held_structure.sum(axis=1)))
    by_chance = after**2 * float(np.sqrt(len(best.held_residual)))
    if after <= NOISE_RMS and together <= UNEXPLAINED_Z * by_chance:
        return []
    if struck:
        first = (
            f"{after:.3g} noise standard deviations are left of {before:.3g} on the held-out runs, "
            "sample by sample: blows fall at moments that no simulation repeats."
        )
    elif after > NOISE_RMS:
        share = 100 * after / max(before, 1e-12)
        first = (
            f"{after:.3g} noise standard deviations are left of {before:.3g} on the held-out runs "
            f"({share:.0f} %): something is missing that was not named."
        )
    else:
        first = (
            f"What is left is no larger than the noise ({after:.2f} of its standard deviations), "
            "but hangs together in time: something small is missing that was not named."
        )
    return [first, *where_it_lives(location, most=most, always=True)]


def left_motions(
    machine: Machine, comparison: Comparison, hypothesis: Hypothesis
) -> tuple[JointMotion, ...] | None:
    """Motion of the runs with the residual torque of the corrected model.

    Parameters
    ----------
    machine : Machine
        The nominal model.
    comparison : Comparison
        The runs.
    hypothesis : Hypothesis
        The effects added to it.

    Returns
    -------
    tuple of JointMotion or None
        None where that torque is not known: an effect adds motion that nothing measures, or says
        that the readings are not what they seem.
    """
    pairs = hypothesis.pairs
    if any(effect.adds_motion or type(effect).read is not Effect.read for effect, _ in pairs):
        return None
    spec = machine.spec.copy()
    hypothesis.edit(spec)
    corrected = replace(machine, spec=spec)
    if corrected.model.nv != machine.model.nv:
        return None
    found = []
    for trial in comparison.trials:
        controls, clock = trial.controls, trial.step * np.arange(trial.steps, dtype=float)
        for effect, values in pairs:
            controls = effect.command(clock, controls, values)
        motion = joint_motion(
            corrected, replace(trial, controls=controls), comparison.channels, comparison.floors
        )
        found.append(_with_torques(motion, pairs))
    return tuple(found)


def _with_torques(motion: JointMotion, pairs: Sequence[tuple[Effect, Array]]) -> JointMotion:
    """Add the effects' joint torques to the model torque."""
    added = [
        effect.torque(motion.position, motion.speed, values)
        for effect, values in pairs
        if type(effect).torque is not Effect.torque
    ]
    return replace(motion, missing=motion.missing + sum(added)) if added else motion
