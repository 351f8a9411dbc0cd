"""Orders candidates by what each could explain; it never decides.

Every candidate is simulated once from each of its starts, on top of the present fit. What that
changes in the residual is its signature. The present parameters are free to take up their share
of a signature; what is left of it is held against what is left of the residual.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from loose_env.gap.comparison import Comparison
from loose_env.gap.effect import Effect
from loose_env.gap.fit import Fit, hypothesis_of, parameters_of, prior_of, started

__all__ = ["Screened", "screen"]

Array = NDArray[np.float64]

_GROUP = 24
"""Hypotheses simulated at a time."""
_LARGEST_SHARE = 4.0
"""Largest multiple of a signature that is believed."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Screened:
    """What one start of one candidate promises."""

    effect: Effect
    """The candidate."""
    values: tuple[float, ...]
    """Where a fit should start."""
    promise: float
    """Share of the sum of squares that it would explain, at most 1."""
    sureness: float
    """Promise over its own scatter from block to block, in standard deviations."""


def screen(
    comparison: Comparison,
    fitted: Fit,
    candidates: Sequence[Effect],
    *,
    proposed: Mapping[tuple[str, str, str], Sequence[tuple[float, ...]]] = MappingProxyType({}),
) -> list[Screened]:
    """Screen candidates; the most promising first, each with its best start.

    Parameters
    ----------
    comparison : Comparison
        What is compared.
    fitted : Fit
        The present hypothesis, with its sensitivities.
    candidates : sequence of Effect
        What may be added.
    proposed : mapping
        Starts that the data propose, by the candidate's key, in place of its own.
    """
    parameters = parameters_of(fitted.effects)
    _, weights = prior_of(parameters)
    curvature = fitted.jacobian.T @ fitted.jacobian + np.diag(weights**2 + 1e-9)
    residual = fitted.residual
    left = residual - fitted.jacobian @ np.linalg.solve(curvature, fitted.jacobian.T @ residual)
    total = float(left @ residual)
    entries = [
        (effect, start)
        for effect in candidates
        for start in proposed.get(effect.key) or effect.starts
    ]
    best: dict[int, Screened] = {}
    for begin in range(0, len(entries), _GROUP):
        group = entries[begin : begin + _GROUP]
        tried = [
            hypothesis_of((*fitted.effects, effect), started(fitted, effect, start))
            for effect, start in group
        ]
        signatures = comparison.residuals(tried) - residual
        for (effect, start), signature in zip(group, signatures, strict=True):
            found = _weigh(comparison, fitted, curvature, left, total, effect, start, signature)
            if found is not None:
                known = best.get(id(effect))
                if known is None or found.promise > known.promise:
                    best[id(effect)] = found
    return sorted(best.values(), key=lambda s: -s.promise)


def _weigh(
    comparison: Comparison,
    fitted: Fit,
    curvature: Array,
    left: Array,
    total: float,
    effect: Effect,
    start: tuple[float, ...],
    signature: Array,
) -> Screened | None:
    """What a signature promises, once the present parameters have taken up their share."""
    jacobian = fitted.jacobian
    own = signature - jacobian @ np.linalg.solve(curvature, jacobian.T @ signature)
    size = float(own @ signature)
    if not size > 0 or not np.isfinite(size):
        return None
    share = -float(own @ left) / size
    values = start
    if effect.nothing is not None:
        share = float(np.clip(share, -_LARGEST_SHARE, _LARGEST_SHARE))
        values = _along(effect, start, effect.nothing, share)
    elif share <= 0:
        return None
    elif effect.proportional is not None:
        share = min(share, _LARGEST_SHARE)
        values = _along(effect, start, (0.0,) * len(start), share)
    else:
        share = min(share, 1.0)
    scores = comparison.by_block(own * left)
    scatter = float(np.sqrt(np.sum(scores**2)))
    explained = -2 * share * float(own @ left) - share**2 * size
    if explained <= 0:
        return None
    return Screened(
        effect=effect,
        values=values,
        promise=explained / max(total, 1e-30),
        sureness=abs(float(scores.sum())) / max(scatter, 1e-30),
    )


def _along(
    effect: Effect, start: Sequence[float], nothing: Sequence[float], share: float
) -> tuple[float, ...]:
    """Values at a share of the way from nothing to the start, within the bounds.

    All parameters go that way, or only the one that what the effect changes is proportional to.
    """
    return tuple(
        p.clipped(none + share * (value - none)) if effect.proportional in (None, k) else value
        for k, (p, none, value) in enumerate(zip(effect.parameters, nothing, start, strict=True))
    )
