"""Effects that the recorded motions cannot identify or tell apart, and the recording time needed.

Every effect is simulated once at a size that would matter, on top of the identified effects. The
change of the readings, after projecting out the nominal parameters within their tolerance, is the
information available to a fit: its length determines whether the effect is visible, and the part
that another effect cannot absorb whether the two are distinguishable. The growth of both with
recording time gives the additional length of the same motions needed, if any: no length
distinguishes an effect from a parameter within its tolerance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from loose_env.gap.fitting.gauss_newton import (
    Fit,
    cost_of,
)
from loose_env.gap.fitting.model_structure import prior_of
from loose_env.gap.fitting.refit import with_new_jacobian
from loose_env.gap.model.effect import Effect
from loose_env.gap.output.evidence_schema import (
    ConfusablePair,
    Identifiability,
    UnidentifiableEffect,
)
from loose_env.gap.residuals.autocorrelation import independent_rows
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.gap.residuals.windows import windowed
from loose_env.gap.selection.screening.confusable_effects import confusable
from loose_env.gap.selection.screening.screening import along
from loose_env.gap.selection.screening.signatures import Signatures
from loose_env.gap.settings import (
    IDENTIFIABLE_Z,
)
from loose_env.typing import Array

_SECONDS = 4.0
"""How much of the runs is looked at, in all [s]."""
_NEARLY = 0.2
"""Share of a signature that another one leaves, up to which it is tried at its best size."""
_NEVER = 1e3
"""Factor on the length of the runs above which more of the same is no help."""
_PRECISION = 1.05
"""Ratio to which such a factor is found."""
_RIDGE = 1e-12
"""What is added to the diagonal of a scaled problem, against rounding."""


@dataclass(frozen=True, eq=False)
class _Signature:
    """Change of the readings by an effect (N,), in standard deviations."""

    effect: Effect
    values: tuple[float, ...]
    change: Array


def identifiability(
    comparison: ResidualModel, best: Fit, candidates: Sequence[Effect]
) -> Identifiability:
    """Determine the effects that the training runs can identify."""
    short = windowed(comparison, _SECONDS)
    base = _on(comparison, short, best)
    seconds = sum(float(trial.time[-1]) for trial in comparison.trials)
    looked = sum(float(trial.time[-1]) for trial in short.trials)
    # In standard deviations of all the runs, with the residual counted as their noise.
    rms = max(float(np.sqrt(np.mean(base.residual**2))), 1.0)
    rows = independent_rows(base.residual, short.rows.block, short.rows.channel)
    unit = float(np.sqrt(rows / len(base.residual) * max(seconds / looked, 1.0))) / rms
    named = _of_named(short, base, unit)
    taken = {(each.effect.kind, each.effect.where) for each, _ in named}
    others = [c for c in candidates if (c.kind, c.where) not in taken and short.shows(c)]
    nuisance = _Fitted.of(base, slice(0, len(base.structure.nuisance.parameters)), unit)
    seen: dict[tuple[str, str], tuple[float, _Signature]] = {}
    for each in _of_candidates(short, base, others, unit):
        length, key = nuisance.length(each.change), (each.effect.kind, each.effect.where)
        if key not in seen or length > seen[key][0]:
            seen[key] = length, each
    unseen = [
        UnidentifiableEffect(
            kind=each.effect.kind,
            where=each.effect.where,
            parameters={
                p.name: float(v) for p, v in zip(each.effect.parameters, each.values, strict=True)
            },
            z=length,
            additional_s=nuisance.more(each.change, seconds),
        )
        for length, each in seen.values()
        if length < IDENTIFIABLE_Z
    ]
    shown = [each for length, each in seen.values() if length >= IDENTIFIABLE_Z]
    pairs = _with_named(short, named, shown, unit, seconds)
    pairs += _among(nuisance, shown, seconds)
    return Identifiability(unidentifiable=tuple(unseen), confusable=tuple(pairs))


def _on(comparison: ResidualModel, short: ResidualModel, best: Fit) -> Fit:
    """The best fit on some windows, with sensitivities of its own."""
    if short is comparison:
        return with_new_jacobian(best, comparison)
    nuisance = best.structure.nuisance  # windows have other initial states
    structure = replace(best.structure, nuisance=replace(nuisance, initial=None))
    free = best.free[nuisance.initial_slice.stop :]
    residual = short.residuals([structure.hypothesis(free)])[0]
    cost = cost_of(residual, free, structure.parameters)
    fitted = replace(best, structure=structure, free=free, residual=residual, cost=cost)
    return with_new_jacobian(fitted, short)


@dataclass(frozen=True, eq=False)
class _Fitted:
    """Jointly fitted parameters, with their priors."""

    jacobian: Array
    """Change of the readings with them, in standard deviations (N, P)."""
    weights: Array
    """Prior weight of each, 0: none (P,)."""
    curvature: Array
    """Squares and products of the jacobian's columns (P, P)."""

    @classmethod
    def of(cls, base: Fit, own: slice, unit: float) -> _Fitted:
        """Those of a slice of a fit's parameter vector."""
        jacobian = unit * base.jacobian[:, own]
        weights = prior_of(base.structure.parameters[own])[1]
        return cls(jacobian, weights, jacobian.T @ jacobian)

    def size(self, change: Array, other: Array) -> float:
        """Coefficient of another change that absorbs most of one (N,), in a joint fit."""
        whole = self.curvature + np.diag(self.weights**2)
        scale = np.sqrt(np.maximum(np.diag(whole), 1e-300))
        scaled = whole / np.outer(scale, scale) + _RIDGE * np.eye(len(whole))
        one, two = (self.jacobian.T @ each / scale for each in (change, other))
        taken = np.linalg.solve(scaled, two)
        left = float(other @ other) - float(two @ taken)
        return (float(change @ other) - float(one @ taken)) / max(left, 1e-300)

    def length(self, change: Array, other: Array | None = None, *, times: float = 1.0) -> float:
        """Length of a change of the readings (N,), all fitted parameters projected out."""
        across, curvature, weights = self.jacobian.T @ change, self.curvature, self.weights
        if other is not None:
            beside = self.jacobian.T @ other
            curvature = np.block([[curvature, beside[:, None]], [beside[None], other @ other]])
            across, weights = np.append(across, other @ change), np.append(weights, 0.0)
        whole = times * curvature + np.diag(weights**2)
        scale = np.sqrt(np.maximum(np.diag(whole), 1e-300))
        scaled = whole / np.outer(scale, scale) + _RIDGE * np.eye(len(whole))
        taken = across / scale @ np.linalg.solve(scaled, across / scale)
        return float(np.sqrt(max(times * float(change @ change) - times**2 * float(taken), 0.0)))

    def more(self, change: Array, seconds: float, other: Array | None = None) -> float | None:
        """Additional length of the runs needed [s]; None where no length will do."""
        low, high = 1.0, _NEVER
        if self.length(change, other, times=high) < IDENTIFIABLE_Z:
            return None
        while high / low > _PRECISION:
            middle = float(np.sqrt(low * high))
            enough = self.length(change, other, times=middle) >= IDENTIFIABLE_Z
            low, high = (low, middle) if enough else (middle, high)
        return (high - 1.0) * seconds


def _of_named(short: ResidualModel, base: Fit, unit: float) -> list[tuple[_Signature, Fit]]:
    """Identified effects at fitted size, their signatures, and the fit without each."""
    found = []
    for effect, own in zip(base.effects, base.structure.slices, strict=True):
        others = base.structure.with_effects([e for e in base.effects if e is not effect])
        kept = np.delete(np.arange(len(base.free)), np.arange(own.start, own.stop))
        residual = short.residuals([others.hypothesis(base.free[kept])])[0]
        without = replace(
            base, structure=others, free=base.free[kept], residual=residual,
            jacobian=base.jacobian[:, kept],
        )  # fmt: skip
        found.append((_Signature(effect, (), unit * (base.residual - residual)), without))
    return found


def _of_candidates(
    short: ResidualModel, base: Fit, candidates: Sequence[Effect], unit: float
) -> list[_Signature]:
    """Candidates at the first of their starts, without those that affect no reading."""
    entries = [(c, tuple(c.starts[0])) for c in candidates]
    return [each for each in _changes(short, base, entries, unit) if each.change.any()]


def _changes(
    short: ResidualModel,
    base: Fit,
    entries: Sequence[tuple[Effect, tuple[float, ...]]],
    unit: float,
) -> list[_Signature]:
    """Changes of the readings by effects of some size, on top of the best fit.

    The difference of two cheap simulations is accurate enough: the step error is in both.
    """
    found: list[_Signature | None] = [None] * len(entries)
    stiff = any(effect.adds_motion for effect in base.effects)
    for springs in (True, False):
        own = [k for k, (effect, _) in enumerate(entries) if effect.adds_motion == springs]
        if not own:
            continue
        compared, alike = short.cheaper_residual(
            base.hypothesis, base.residual, stiff=stiff, springs=springs
        )
        changes = Signatures().of(compared, base, [entries[k] for k in own], alike)
        for k, (effect, values, change) in zip(own, changes, strict=True):
            found[k] = _Signature(effect, values, unit * change)
    return [each for each in found if each is not None]


def _with_named(
    short: ResidualModel,
    named: Sequence[tuple[_Signature, Fit]],
    others: Sequence[_Signature],
    unit: float,
    seconds: float,
) -> list[ConfusablePair]:
    """Identified effects that another one could replace, the rest unchanged."""
    found = []
    for one, without in named:
        fitted = _Fitted.of(without, slice(None), unit)
        pairs = [(_pair(fitted, one, other, seconds), other) for other in others]
        own = fitted.length(one.change)
        near = [k for k, (pair, _) in enumerate(pairs) if pair.z < _NEARLY * own]
        # An effect with a similar signature may fit equally well at another size, or only at a size
        # that it cannot have, such as that of a friction that adds energy.
        again = [_resized(pairs[k][1], fitted.size(one.change, pairs[k][1].change)) for k in near]
        there = _changes(short, without, again, unit)
        for k, other in zip(near, there, strict=True):
            pairs[k] = _pair(fitted, one, other, seconds), other
        found += [pair for pair, _ in pairs]
    return _sorted(found)


def _resized(seen: _Signature, share: float) -> tuple[Effect, tuple[float, ...]]:
    """An effect at a multiple of its size."""
    effect, values = seen.effect, seen.values
    if effect.null_values is not None:
        return effect, along(effect, values, effect.null_values, share)
    if effect.proportional is not None:
        return effect, along(effect, values, (0.0,) * len(values), share)
    return effect, values


def _among(fitted: _Fitted, shown: Sequence[_Signature], seconds: float) -> list[ConfusablePair]:
    """Pairs of confusable effects that were not identified."""
    found = []
    for k, one in enumerate(shown):
        for other in shown[k + 1 :]:
            if confusable(one.effect, other.effect):
                orders = ((one, other), (other, one))
                found.append(min((_pair(fitted, *o, seconds) for o in orders), key=_z))
    return _sorted(found)


def _sorted(pairs: Sequence[ConfusablePair]) -> list[ConfusablePair]:
    """Pairs that are not distinguishable, most confusable first."""
    return sorted((pair for pair in pairs if pair.z < IDENTIFIABLE_Z), key=_z)


def _z(pair: ConfusablePair) -> float:
    return pair.z


def _pair(fitted: _Fitted, one: _Signature, other: _Signature, seconds: float) -> ConfusablePair:
    length = fitted.length(one.change, other.change)
    return ConfusablePair(
        kind=one.effect.kind,
        where=one.effect.where,
        other_kind=other.effect.kind,
        other_where=other.effect.where,
        z=length,
        additional_s=fitted.more(one.change, seconds, other.change)
        if length < IDENTIFIABLE_Z
        else 0.0,
    )
