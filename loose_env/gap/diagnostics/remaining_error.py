"""Residual of the corrected model: its size and location in sentences, its torque by joint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from loose_env.gap.diagnostics.joint_torque_residual import JointMotion, joint_motion
from loose_env.gap.diagnostics.localisation import location_notes
from loose_env.gap.fitting.holdout_score import ScoredFit
from loose_env.gap.model.driven_effect import DrivenEffect
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.output.evidence_schema import Location
from loose_env.gap.residuals.autocorrelation import largest
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.gap.settings import (
    NOISE_RMS,
    UNEXPLAINED_Z,
)
from loose_env.typing import Array


def remaining_notes(
    base: ScoredFit, best: ScoredFit, location: Location, *, impact_fit: bool = False
) -> list[str]:
    """Describe the residual of the corrected model in sentences; none if it is noise."""
    before, after = base.held_out_rms, best.held_out_rms
    together = float(largest(best.held_out_products.sum(axis=1)))
    by_chance = after**2 * float(np.sqrt(len(best.held_out_residual)))
    if after <= NOISE_RMS and together <= UNEXPLAINED_Z * by_chance:
        return []
    if impact_fit:
        first = (
            f"Residual on the held-out runs, sample by sample: {after:.3g} of {before:.3g} noise "
            "standard deviations; the times of impacts are not reproducible."
        )
    elif after > NOISE_RMS:
        share = 100 * after / max(before, 1e-12)
        first = (
            f"Residual on the held-out runs: {after:.3g} of {before:.3g} noise standard deviations "
            f"({share:.0f} %); a further effect is missing that was not identified."
        )
    else:
        first = (
            f"The residual is no larger than the noise ({after:.2f} of its standard deviations), "
            "but autocorrelated: a small effect is missing that was not identified."
        )
    return [first, *location_notes(location, most=3, always=True)]


def remaining_motions(
    machine: NominalModel, comparison: ResidualModel, hypothesis: Hypothesis
) -> tuple[JointMotion, ...] | None:
    """Motion of the runs with the residual torque of the corrected model."""
    pairs = hypothesis.pairs
    inverse = any(trial.form == "inverse" for trial in comparison.trials)
    if any(_torque_unknown(effect, inverse=inverse) for effect, _ in pairs):
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


def _torque_unknown(effect: Effect, *, inverse: bool) -> bool:
    """Return whether a model with the effect does not tell the joint torque of a motion."""
    own = type(effect)
    if effect.adds_motion or own.read is not Effect.read or isinstance(effect, DrivenEffect):
        return True
    # of torques compared with motion these are parts that no MJCF has
    return inverse and (
        own.passive_actuator_torque is not Effect.passive_actuator_torque
        or own.sensed_torque is not Effect.sensed_torque
    )


def _with_torques(motion: JointMotion, pairs: Sequence[tuple[Effect, Array]]) -> JointMotion:
    """Add the effects' joint torques to the model torque."""
    added = [
        effect.torque(motion.position, motion.speed, values)
        for effect, values in pairs
        if type(effect).torque is not Effect.torque
    ]
    return replace(motion, residual_torque=motion.residual_torque + sum(added)) if added else motion
