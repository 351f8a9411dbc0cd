"""Screening of candidates: ranked by predicted explained variance, one simulation per start.

Every candidate is simulated once from each of its starts, on top of the current fit: with a cheaper
integrator, but for springs in simulated runs. The resulting change of the residual is its
signature. The current parameters are free to absorb part of a signature; the remainder is projected
onto the residual.

Effects that shift signals in time are screened twice. An acceleration of many hertz is linear in a
shift over a fraction of a millisecond only, so that a slightly wrong start predicts no gain;
positions and speeds are linear over a longer range, and give a better start.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from loose_env.gap.fitting.gauss_newton import Fit
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.effects.mjcf.sensor_columns import is_position_or_speed
from loose_env.gap.model.parameter import Parameter, free_of
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.gap.selection.screening.linear_problem import CurrentFit
from loose_env.gap.selection.screening.signatures import Signatures
from loose_env.gap.settings import SECOND_START
from loose_env.typing import Array

_SMALLEST_SHARE, _LARGEST_SHARE = 1e-6, 4.0
"""Smallest and largest multiple of a signature that is believed."""
_DISTINCT_START = 0.5
"""Distance of a start that is another, in free numbers: some one of them is so far off."""
_MANY = 4
"""Starts of one candidate above which only the best on the run with the largest residual are
simulated on all."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ScreenedCandidate:
    """Predicted gain of one candidate from one start."""

    effect: Effect
    """The candidate."""
    values: tuple[float, ...]
    """Starting values of a fit."""
    predicted: float
    """Predicted share of the sum of squares explained, at most 1."""
    z: float
    """Predicted gain over its standard deviation between blocks (z)."""
    second: tuple[float, ...] | None = None
    """Another start, far from the first, with at least half its predicted gain."""
    signature: NDArray[np.float32] | None = None
    """Change of the residual with the effect at these values, as far as it is linear (N, 1); of an
    effect with `Effect.axes` with each of these (N, K)."""
    shares: tuple[float, float] = (0.0, 1.0)
    """Multiples of the signature that are believed."""

    def at(self, shares: Array) -> tuple[float, ...]:
        """Values at which the effect has multiples of its signature (1,) or (K,)."""
        effect, none = self.effect, self.effect.null_values
        if len(shares) > 1:
            return effect.combined(shares)
        if none is None and effect.proportional is None:
            return self.values
        return along(effect, self.values, none or (0.0,) * len(self.values), float(shares[0]))


def screen(
    comparison: ResidualModel,
    fitted: Fit,
    candidates: Sequence[Effect],
    *,
    proposed: Mapping[tuple[str, str, str], Sequence[tuple[float, ...]]] = MappingProxyType({}),
    signatures: Signatures | None = None,
) -> list[ScreenedCandidate]:
    """Screen candidates; highest predicted gain first, each with one or two starts."""
    signatures = signatures or Signatures()
    signatures.about(comparison, fitted)
    known = CurrentFit.of(fitted)
    slow = _slow_rows(comparison)
    smooth_channels_problem = CurrentFit.of(fitted, slow) if 0 < slow.sum() < len(slow) else None
    stiff = any(e.adds_motion for e in fitted.effects)
    proposed = dict(proposed) | _best_starts(
        comparison, fitted, known, candidates, proposed, signatures
    )
    seen: dict[int, list[ScreenedCandidate]] = {}
    for springs in (True, False):
        compared, base = comparison.cheaper_residual(
            fitted.hypothesis, fitted.residual, stiff=stiff, springs=springs
        )
        own = [effect for effect in candidates if effect.adds_motion == springs]
        axes = {id(effect): (effect, effect.axes) for effect in own if effect.axes}
        entries = [
            (effect, start)
            for effect in own
            for start in dict.fromkeys(
                (
                    *(proposed.get(effect.key) or _starts(comparison, effect)),
                    *axes.get(id(effect), (effect, ()))[1],
                )
            )
        ]
        apart: dict[int, dict[tuple[float, ...], Array]] = {}
        again: dict[int, tuple[float, Effect, tuple[float, ...]]] = {}
        for effect, start, signature in signatures.of(compared, fitted, entries, base):
            _keep(seen, _predicted_gain(comparison, known, effect, start, signature))
            if id(effect) in axes:
                apart.setdefault(id(effect), {})[start] = signature
            if smooth_channels_problem is not None and effect.is_time_shift:
                found = _proposed(smooth_channels_problem, slow, effect, start, signature)
                if found is not None and found[0] > again.get(id(effect), (0.0,))[0]:
                    again[id(effect)] = (found[0], effect, found[1])
        for key, (effect, starts) in axes.items():
            together = np.stack([apart[key][start] for start in starts], axis=1)
            _keep(seen, _joint_predicted_gain(comparison, known, effect, together))
        entries = [(effect, start) for _, effect, start in again.values()]
        for effect, start, signature in signatures.of(compared, fitted, entries, base):
            _keep(seen, _predicted_gain(comparison, known, effect, start, signature))
    return sorted((_best(each) for each in seen.values()), key=lambda s: -s.predicted)


def _best_starts(
    comparison: ResidualModel,
    fitted: Fit,
    known: CurrentFit,
    candidates: Sequence[Effect],
    proposed: Mapping[tuple[str, str, str], Sequence[tuple[float, ...]]],
    signatures: Signatures,
) -> dict[tuple[str, str, str], list[tuple[float, ...]]]:
    """Select the best starts of candidates with many, such as loose-link directions.

    Of starts that differ in nuisance parameters alone, such as the stiffness of stops, the best one
    represents all.
    """
    entries = [
        (effect, start)
        for effect in candidates
        for starts in [proposed.get(effect.key) or _starts(comparison, effect)]
        for start in starts
        if effect.adds_motion and len(starts) > _MANY
    ]
    if not entries:
        return {}
    rows = comparison.run_with_largest_residual(signatures.reference(comparison, fitted))
    part, residual = comparison, fitted.residual
    if rows is not None:
        part, residual = comparison.of_run(rows), residual[rows]
        known = CurrentFit.of(fitted, rows)
    cheaper, base = part.cheaper_residual(fitted.hypothesis, residual, stiff=True)
    if cheaper is comparison:
        return {}
    found: dict[tuple[str, str, str], dict[tuple[float, ...], tuple[float, tuple[float, ...]]]] = {}
    for effect, start, signature in signatures.of(cheaper, fitted, entries, base):
        candidate = _predicted_gain(part, known, effect, start, signature)
        predicted = 0.0 if candidate is None else candidate.predicted
        own, alike = found.setdefault(effect.key, {}), _without_nuisances(effect, start)
        if alike not in own or predicted > own[alike][0]:
            own[alike] = predicted, start
    return {
        key: [start for _, start in sorted(own.values(), key=lambda each: -each[0])[:_MANY]]
        for key, own in found.items()
    }


def _starts(comparison: ResidualModel, effect: Effect) -> tuple[tuple[float, ...], ...]:
    """Starts of an effect for the forms of run in the recording."""
    return effect.inverse_starts if comparison.rows.inverse.all() else effect.starts


def _without_nuisances(effect: Effect, values: Sequence[float]) -> tuple[float, ...]:
    """Values of the parameters that have no prior, nuisance parameters left out."""
    return tuple(v for p, v in zip(effect.parameters, values, strict=True) if p.centre is None)


def _keep(seen: dict[int, list[ScreenedCandidate]], found: ScreenedCandidate | None) -> None:
    """Store the predicted gain of a start with the others of its candidate, the best one first.

    The signature of the best one alone is kept: all of them would fill the memory.
    """
    if found is None:
        return
    others = seen.setdefault(id(found.effect), [])
    if others and others[0].predicted >= found.predicted:
        others.append(replace(found, signature=None))
        return
    others[:] = [found, *(replace(each, signature=None) for each in others)]


def _best(found: list[ScreenedCandidate]) -> ScreenedCandidate:
    """Best start of a candidate, with another that lies far from it."""
    first, *others = sorted(found, key=lambda s: -s.predicted)
    at = free_of(first.effect.parameters, np.array(first.values))
    matter = np.array([p.centre is None for p in first.effect.parameters])
    for each in others:
        if each.predicted < SECOND_START * first.predicted:
            break
        off = np.abs(free_of(each.effect.parameters, np.array(each.values)) - at)
        if np.any(off[matter] > _DISTINCT_START):
            return replace(first, second=each.values)
    return first


def _slow_rows(comparison: ResidualModel) -> NDArray[np.bool_]:
    """Mask of the rows whose readings vary smoothly with a shift in time (N,)."""
    slow = np.array(
        [is_position_or_speed(comparison.machine, c.column) for c in comparison.channels]
    )
    return slow[comparison.rows.channel] & ~comparison.rows.is_feature


def _predicted_gain(
    comparison: ResidualModel,
    known: CurrentFit,
    effect: Effect,
    start: tuple[float, ...],
    signature: Array,
) -> ScreenedCandidate | None:
    """Predicted gain of a signature after refitting the current parameters."""
    linear = effect.null_values is not None
    most = _LARGEST_SHARE if linear or effect.proportional is not None else 1.0
    taken = known.best_coefficients(signature[:, None], -_LARGEST_SHARE if linear else 0.0, most)
    if taken is None or abs(taken[0][0]) < _SMALLEST_SHARE:
        return None
    share, values = float(taken[0][0]), start
    if effect.null_values is not None:
        values = along(effect, start, effect.null_values, share)
    elif effect.proportional is not None:
        values = along(effect, start, (0.0,) * len(start), share)
    found = _screened(comparison, known, effect, values, taken[1])
    ends = sorted((most / share, (-most if linear else 0.0) / share))
    return found and replace(
        found, signature=(share * signature[:, None]).astype(np.float32), shares=(ends[0], ends[1])
    )


def _joint_predicted_gain(
    comparison: ResidualModel,
    known: CurrentFit,
    effect: Effect,
    signatures: Array,
) -> ScreenedCandidate | None:
    """Predicted gain of the signatures of an effect's axes (N, K), jointly fitted."""
    taken = known.best_coefficients(signatures, -_LARGEST_SHARE, _LARGEST_SHARE)
    if taken is None or (values := effect.combined(taken[0])) == effect.null_values:
        return None
    found = _screened(comparison, known, effect, values, taken[1])
    columns = signatures.astype(np.float32)
    ends = (-_LARGEST_SHARE, _LARGEST_SHARE)
    return found and replace(found, signature=columns, shares=ends)


def _screened(
    comparison: ResidualModel,
    known: CurrentFit,
    effect: Effect,
    values: tuple[float, ...],
    change: Array,
) -> ScreenedCandidate | None:
    """Predicted gain of a change of the residual (N,); None if it is no better."""
    residual = known.residual
    gains = comparison.by_block(-change * (2 * residual + change))
    if gains.sum() <= 0:
        return None
    return ScreenedCandidate(
        effect=effect,
        values=values,
        predicted=float(gains.sum() / (residual @ residual)),
        z=float(gains.sum() / np.sqrt(np.sum(gains**2))),
    )


def _proposed(
    smooth_channels_problem: CurrentFit,
    rows: NDArray[np.bool_],
    effect: Effect,
    start: tuple[float, ...],
    signature: Array,
) -> tuple[float, tuple[float, ...]] | None:
    """Predicted explained share from some of the rows, and the values that give it."""
    taken = smooth_channels_problem.best_coefficients(signature[rows, None], 0.0, _LARGEST_SHARE)
    if taken is None or effect.null_values is None:
        return None
    share, change = float(taken[0][0]), taken[1]
    gain = -float(change @ (2 * smooth_channels_problem.residual + change))
    if gain <= 0 or share < _SMALLEST_SHARE:
        return None
    return gain / float(smooth_channels_problem.residual @ smooth_channels_problem.residual), along(
        effect, start, effect.null_values, share
    )


def along(
    effect: Effect, start: Sequence[float], null_values: Sequence[float], share: float
) -> tuple[float, ...]:
    """Interpolate values between the null effect and the start, within the bounds.

    All parameters are interpolated, or only the one to which the change is proportional. Gains are
    interpolated as ratios: twice the step from a whole gain to a half of it is a quarter.
    """
    return tuple(
        p.clipped(_between(p, none, value, share)) if effect.proportional in (None, k) else value
        for k, (p, none, value) in enumerate(
            zip(effect.parameters, null_values, start, strict=True)
        )
    )


def _between(parameter: Parameter, none: float, value: float, share: float) -> float:
    """Interpolate between the null value and a value."""
    if parameter.log and none > 0:
        return float(none * (value / none) ** share)
    return none + share * (value - none)
