"""Sets of effects that may replace those of a fitted answer, linearised about its fit.

What was named first was chosen for what it explains of all that is missing, at the nominal model.
Two shifts of a centre of mass may have stood in for a load and an offset, and no single exchange
leads back. At the answer the linearisation is better, and its effects can go like any other
candidate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from loose_env.gap.fitting.gauss_newton import Fit
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.parameter import free_of, values_of
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.gap.selection.screening.joint_proposals import JointProblem
from loose_env.gap.selection.screening.screening import ScreenedCandidate, along
from loose_env.typing import Array

_STEP = 1e-4
"""Difference of a share over which free numbers are differentiated."""
_MAX_EXTRAPOLATION = 4.0
"""Largest multiple of what an effect does now that is believed."""


@dataclass(frozen=True, kw_only=True, eq=False)
class AlternativeSet:
    """Effects that may explain more than those of an answer."""

    effects: tuple[Effect, ...]
    """All of them, those that stay and new ones."""
    values: tuple[tuple[float, ...], ...]
    """Values of the joint solution, by effect."""


def alternative_sets(
    comparison: ResidualModel, fitted: Fit, screened: Sequence[ScreenedCandidate], most: int
) -> list[AlternativeSet]:
    """Sets that are worth more than the effects of a fit, the best ones first."""
    stay = list(range(len(fitted.structure.nuisance.parameters)))
    residual, own = fitted.residual, list[ScreenedCandidate]()
    kept: dict[Effect, tuple[float, ...]] = {}
    for effect, part in zip(fitted.effects, fitted.structure.slices, strict=True):
        values = tuple(values_of(effect.parameters, fitted.free[part]))
        none = _none(effect)
        if none is None:  # it vanishes in a limit only, and stays
            stay += range(part.start, part.stop)
            kept[effect] = values
            continue
        columns, shares = _columns(effect, none, fitted.free[part], fitted.jacobian[:, part])
        residual = residual - columns @ shares
        most_of_it = _MAX_EXTRAPOLATION * max(shares.max(), 1.0)
        own.append(
            ScreenedCandidate(
                effect=effect,
                values=values,
                predicted=1.0,
                z=0.0,
                signature=columns.astype(np.float32),
                shares=(-most_of_it, most_of_it),
            )
        )
    prior = fitted.cost - float(fitted.residual @ fitted.residual)
    without = replace(
        fitted,
        structure=fitted.structure.with_effects(tuple(kept)),
        free=fitted.free[stay],
        jacobian=fitted.jacobian[:, stay],
        residual=residual,
        cost=prior + float(residual @ residual),
    )
    problem = JointProblem(comparison, without, [*own, *screened])
    known = {frozenset(effect.key for effect in fitted.effects)}
    found = []
    for each in problem.better_than(tuple(range(len(own)))):
        effects = (*kept, *(member.effect for member in each.members))
        keys = frozenset(effect.key for effect in effects)
        if keys not in known:
            known.add(keys)
            values_by_effect = (*kept.values(), *(member.values for member in each.members))
            found.append(AlternativeSet(effects=effects, values=values_by_effect))
    return found[:most]


def _none(effect: Effect) -> tuple[float, ...] | None:
    """Values at which an effect vanishes, or those that its change is proportional to do."""
    if effect.null_values is not None or effect.proportional is None:
        return effect.null_values
    return (0.0,) * len(effect.parameters)


def _columns(
    effect: Effect, none: tuple[float, ...], free: Array, jacobian: Array
) -> tuple[Array, Array]:
    """Changes of the residual (N, K) with an effect, linearised where it is, and shares now (K,).

    Of an effect with `Effect.axes` one for each of them; else that from nothing to now.
    """
    values = np.array(values_of(effect.parameters, free))
    if effect.axes:
        shares = effect.shares_of(values)
        slopes = [
            (
                free_of(effect.parameters, np.array(effect.combined(shares + step)))
                - free_of(effect.parameters, np.array(effect.combined(shares - step)))
            )
            / (2 * _STEP)
            for step in _STEP * np.eye(len(shares))
        ]
        return jacobian @ np.array(slopes).T, shares
    without = np.array(along(effect, tuple(values), none, 0.0))
    return (jacobian @ (free - free_of(effect.parameters, without)))[:, None], np.ones(1)
