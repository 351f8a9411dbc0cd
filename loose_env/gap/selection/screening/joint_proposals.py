"""Sets of candidates that explain a residual together, from one linearised problem.

Two effects that mix may each explain little alone, or a third one explain a little of both and rank
first. The signatures of all candidates and the sensitivities of the current parameters are columns
of one bounded linear least-squares problem, which is solved for every pair, for every kind at all
of its locations, and greedily for many effects. It proposes sets to be fitted; it decides nothing.

Rows are divided by the root mean square of their channel's residual: what is wrong in a quiet
channel counts as much as what is wrong in a loud one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from loose_env.gap.fitting.gauss_newton import Fit
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.gap.selection.screening.linear_problem import CurrentFit, bounded_minimum
from loose_env.gap.selection.screening.screening import Screened, at_share
from loose_env.typing import Array

__all__ = ["JointProblem", "Proposal"]

Key = tuple[str, str]
"""Kind and variant, or kind and location."""

_ROWS = 8192
"""Rows multiplied at a time: a matter of memory."""
_SOLVED = 60
"""Pairs that are solved with bounds, by their gain with free parameters and with these held, so
many of each: a matter of cost."""
_TRIED = 5
"""The same for each further effect of a greedily built set."""
_COLLINEAR = 1e-3
"""Share of a signature beyond another one's, below which the two are one direction."""
_GREEDY = 12
"""Effects from which on a set grows no further."""
_WORTH = 0.01
"""Share of the sum of squares that one more effect of a set explains at least."""
_BETTER = 0.001
"""The same for a parameter, and for another set of as many."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Proposal:
    """A set of candidates."""

    members: tuple[Screened, ...]
    """Candidates, with the values of the joint solution."""
    predicted: float
    """Predicted share of the weighted sum of squares that they explain together."""


class JointProblem:
    """The linearised problem of all candidates at the current model.

    Parameters
    ----------
    comparison : ResidualModel
        Comparison of the runs.
    fitted : Fit
        The current model on these runs, with its sensitivities.
    screened : sequence of Screened
        Candidates with their signatures, the most promising first.
    """

    def __init__(
        self, comparison: ResidualModel, fitted: Fit, screened: Sequence[Screened]
    ) -> None:
        self.screened = [each for each in screened if each.signature is not None]
        weights = _weights(comparison, fitted.residual)
        weighted = replace(
            fitted,
            jacobian=fitted.jacobian * weights[:, None],
            residual=fitted.residual * weights,
        )
        known = CurrentFit.of(weighted)
        across, sizes, slope = self._products(weights, known.jacobian, known.residual)
        self._known = len(known.slope)
        self._whole = float(known.residual @ known.residual)
        self._curvature = np.block([[known.curvature, across], [across.T, sizes]])
        self._slope = np.concatenate([known.slope, slope])
        least, most = np.array([each.shares for each in self.screened]).T.reshape(2, -1)
        self._low = np.concatenate([known.room[0], least])
        self._high = np.concatenate([known.room[1], most])
        self._scale = np.sqrt(np.diag(self._curvature) + 1e-12)

    def _products(
        self, weights: Array, known: Array, residual: Array
    ) -> tuple[Array, Array, Array]:
        """Products of the signatures with sensitivities, with each other and the residual."""
        count = len(self.screened)
        across, sizes = np.zeros((known.shape[1], count)), np.zeros((count, count))
        slope = np.zeros(count)
        signatures = [each.signature for each in self.screened if each.signature is not None]
        for start in range(0, len(residual), _ROWS):
            part = slice(start, start + _ROWS)
            columns = np.array([each[part] for each in signatures], dtype=float) * weights[part]
            across += known[part].T @ columns.T
            sizes += columns @ columns.T
            slope += columns @ residual[part]
        return across, sizes, slope

    def pairs(self, most: int) -> list[Proposal]:
        """Pairs of candidates at two places or of two kinds, the best ones first."""
        count = len(self.screened)
        if count < 2:
            return []
        apart = np.array([_place(each) for each in self.screened], dtype=object)
        first, second = np.triu_indices(count, 1)
        kept = np.any(apart[first] != apart[second], axis=1)
        first, second = first[kept], second[kept]
        tried: dict[tuple[int, int], None] = {}
        for gram, slope in (self._pinned(), self._reduced()):
            gain = _pair_gains(gram, slope, first, second)
            tried |= {(int(first[k]), int(second[k])): None for k in np.argsort(-gain)[:_SOLVED]}
        return _best([self.solved(pair) for pair in tried], most)

    def kinds(self, most: int) -> list[Proposal]:
        """Every kind at all of its locations, the best ones first.

        Servos, gears and bearings of an arm are alike: settings that differ from the model's are
        seldom those of one joint.
        """
        found = [self.solved(own) for own in self._groups.values()]
        best: dict[str, Proposal] = {}
        for proposal in _best(found, len(found)):
            best.setdefault(proposal.members[0].effect.kind, proposal)
        return list(best.values())[:most]

    def greedy(self) -> list[Proposal]:
        """Sets of many candidates, grown step by step as long as a step explains enough.

        Two are built: from single candidates alone, and from these and kinds at all of their
        locations. What is alike at every joint is told from richer effects at some of them by the
        whole, not by its first member.
        """
        found = [self._grown(()), self._grown(tuple(self._groups.items()))]
        return [each for each in found if each is not None and len(each.members) > 1]

    @cached_property
    def _groups(self) -> dict[Key, tuple[int, ...]]:
        """Candidates (indices) of each kind and variant at several locations."""
        groups: dict[Key, dict[str, int]] = {}
        for k, each in enumerate(self.screened):
            own = groups.setdefault((each.effect.kind, each.effect.variant), {})
            own.setdefault(each.effect.where, k)
        return {key: tuple(own.values()) for key, own in groups.items() if len(own) > 1}

    def _grown(self, groups: Sequence[tuple[Key, tuple[int, ...]]]) -> Proposal | None:
        """Set that grows by one candidate, or one of some groups (indices), at a time.

        The step is taken that is worth most. Where no further candidate is worth it, one of the
        set is exchanged for another, and it may grow again: the first members were chosen for what
        they explain of all that is missing, and the rest has come since.
        """
        chosen: tuple[int, ...] = ()
        best: Proposal | None = None
        while True:
            better = None
            if len(chosen) < _GREEDY:
                steps = (*self._singles(chosen), *self._wholes(chosen, groups))
                better = self._best_of([(*chosen, *own) for own in steps], best)
            better = better or self._best_of(self._exchanges(chosen), best)
            if better is None:
                return best
            chosen, best = better

    def _best_of(
        self, sets: Sequence[tuple[int, ...]], best: Proposal | None
    ) -> tuple[tuple[int, ...], Proposal] | None:
        """Set (indices) that is worth most; None if none is worth more than the best so far."""
        found = [(own, each) for own in sets if (each := self.solved(own)) is not None]
        least = -np.inf if best is None else _worth(best) + _BETTER
        found = [each for each in found if _worth(each[1]) > least]
        return max(found, key=lambda each: _worth(each[1]), default=None)

    def _exchanges(self, chosen: tuple[int, ...]) -> list[tuple[int, ...]]:
        """Sets with one member exchanged for another candidate."""
        rests = [tuple(k for k in chosen if k != member) for member in chosen]
        return [
            (*rest, *own)
            for member, rest in zip(chosen, rests, strict=True)
            for own in self._singles(rest)
            if rest and own != (member,)
        ]

    def _singles(self, chosen: tuple[int, ...]) -> list[tuple[int]]:
        """Candidates (indices) that gain most beside some others."""
        places = [_place(each) for each in self.screened]
        taken = {places[k] for k in chosen}
        free = np.array([place not in taken for place in places], dtype=bool)
        tried: dict[int, None] = {}
        for gram, slope in (self._pinned(chosen), self._reduced(chosen)):
            size = np.diag(gram)
            gains = np.where(free & (size > 0), slope**2 / np.maximum(size, 1e-12), 0.0)
            tried |= {int(k): None for k in np.argsort(-gains)[:_TRIED] if gains[k] > 0}
        return [(k,) for k in tried]

    def _wholes(
        self, chosen: tuple[int, ...], groups: Sequence[tuple[Key, tuple[int, ...]]]
    ) -> list[tuple[int, ...]]:
        """Groups of further kinds that gain most beside some candidates (indices)."""
        kinds = {self.screened[k].effect.kind for k in chosen}
        left = [own for (kind, _), own in groups if kind not in kinds]
        if not left:
            return []
        gram, slope = self._reduced(chosen)

        def gain(own: tuple[int, ...]) -> float:
            within = gram[np.ix_(own, own)] + 1e-9 * np.diag(np.diag(gram)[list(own)] + 1e-12)
            return float(slope[list(own)] @ np.linalg.lstsq(within, slope[list(own)])[0])

        return sorted(left, key=lambda own: -gain(own))[:_TRIED]

    def solved(self, chosen: tuple[int, ...]) -> Proposal | None:
        """Set of some candidates (indices), solved within all bounds; None if it gains nothing.

        Members that explain less than `_WORTH` of the sum of squares are left out.
        """
        while chosen:
            own = [*range(self._known), *(self._known + k for k in chosen)]
            slope, curvature = self._slope[own], self._curvature[np.ix_(own, own)]
            moved = bounded_minimum(curvature, slope, self._low[own], self._high[own])
            gain = -float(moved @ (2 * slope + curvature @ moved))
            shares = moved[self._known :]
            # what the sum of squares loses if a member goes and nothing else moves
            sizes = np.diag(curvature)[self._known :]
            own_gain = shares**2 * sizes
            weak = np.flatnonzero(own_gain < _WORTH * self._whole)
            if not len(weak):
                break
            worst = int(weak[np.argmin(own_gain[weak])])
            chosen = tuple(k for n, k in enumerate(chosen) if n != worst)
        if not chosen or gain <= 0:
            return None
        members = tuple(
            replace(self.screened[k], values=at_share(self.screened[k], float(share)))
            for k, share in zip(chosen, shares, strict=True)
        )
        return Proposal(members=members, predicted=gain / self._whole)

    def _pinned(self, chosen: tuple[int, ...] = ()) -> tuple[Array, Array]:
        """Gram matrix (C, C) and slope (C,) beside some candidates, the parameters held."""
        return self._beyond([self._known + k for k in chosen])

    def _reduced(self, chosen: tuple[int, ...] = ()) -> tuple[Array, Array]:
        """The same with the parameters free, without their bounds."""
        return self._beyond([*range(self._known), *(self._known + k for k in chosen)])

    def _beyond(self, own: list[int]) -> tuple[Array, Array]:
        """Gram matrix (C, C) and slope (C,) of the signatures less what some numbers absorb."""
        slope, curvature, count = self._slope, self._curvature, self._known
        if not own:
            return curvature[count:, count:], slope[count:]
        scale = self._scale[own]
        across = curvature[own, count:] / scale[:, None]
        within = curvature[np.ix_(own, own)] / np.outer(scale, scale) + 1e-9 * np.eye(len(own))
        taken = np.linalg.solve(within, np.column_stack([across, slope[own] / scale]))
        return (
            curvature[count:, count:] - across.T @ taken[:, :-1],
            slope[count:] - across.T @ taken[:, -1],
        )


def _pair_gains(
    gram: Array, slope: Array, first: NDArray[np.intp], second: NDArray[np.intp]
) -> Array:
    """Fall of the sum of squares with each of some pairs; 0 where the two are one direction."""
    size, cross = np.diag(gram), gram[first, second]
    free = size[first] * size[second] - cross**2
    gain = (
        size[second] * slope[first] ** 2
        + size[first] * slope[second] ** 2
        - 2 * cross * slope[first] * slope[second]
    )
    apart = free > _COLLINEAR * size[first] * size[second]
    return np.where(apart, gain / np.where(apart, free, 1.0), 0.0)


def _weights(comparison: ResidualModel, residual: Array) -> Array:
    """Weight of each row (N,): one over the root mean square of its channel, at most 1."""
    channel = comparison.rows.channel
    count = np.maximum(np.bincount(channel), 1)
    squares: NDArray[np.float64] = np.bincount(channel, residual**2) / count
    return np.asarray(1.0 / np.sqrt(np.maximum(squares, 1.0)))[channel]


def _worth(proposal: Proposal) -> float:
    """Share that a set explains, less what its members and their parameters have to."""
    count = sum(len(member.effect.parameters) for member in proposal.members)
    return proposal.predicted - _WORTH * len(proposal.members) - _BETTER * count


def _place(each: Screened) -> Key:
    """Kind and location: variants and starts of one effect are alternatives."""
    return each.effect.kind, each.effect.where


def _best(found: Sequence[Proposal | None], most: int) -> list[Proposal]:
    """Proposals of two members or more, the best first, none twice."""
    kept: dict[frozenset[tuple[str, str]], Proposal] = {}
    real = (each for each in found if each is not None and len(each.members) > 1)
    for each in sorted(real, key=lambda proposal: -proposal.predicted):
        kept.setdefault(frozenset(_place(member) for member in each.members), each)
    return list(kept.values())[:most]
