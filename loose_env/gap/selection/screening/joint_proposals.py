"""Sets of candidates that explain a residual together, from one linearised least-squares problem.

Two effects that mix may each explain little alone, or a third one explain a little of both and rank
first. The signatures of all candidates and the sensitivities of the current parameters are columns
of one bounded linear least-squares problem, which is solved for every pair, for every kind at all
of its locations, and greedily for many effects. An effect whose changes add up along several axes,
such as the shift of a centre of mass, has a column for each: beside others it is another shift
that explains best. The problem proposes sets to be fitted; it decides nothing.

Rows are divided by the root mean square of their channel's residual: what is wrong in a quiet
channel counts as much as what is wrong in a loud one.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from loose_env.gap.fitting.gauss_newton import Fit
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.gap.selection.screening.linear_problem import CurrentFit
from loose_env.gap.selection.screening.screening import ScreenedCandidate
from loose_env.gap.settings import SHARE_IN_SET
from loose_env.inference import bounded_step
from loose_env.typing import Array

Key = tuple[str, str]
"""Kind and variant, or kind and location."""

_ROWS = 8192
"""Rows multiplied at a time: a matter of memory."""
_SOLVED = 60
"""Pairs that are solved with bounds, by their gain with free parameters and with these held, so
many of each: a matter of cost."""
_TRIED = 5
"""The same for each further effect of a greedily built set."""
_GREEDY = 12
"""Effects from which on a set grows no further."""
_PARAMETER = 0.01
"""`SHARE_IN_SET` for each parameter, and for another set of as many."""
_RIDGE = 1e-3
"""Added to the curvature of each column, over its own, where gains are compared: of columns that
are nearly one direction the difference counts little."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Proposal:
    """A set of candidates."""

    members: tuple[ScreenedCandidate, ...]
    """Candidates, with the values of the joint solution."""
    predicted: float
    """Predicted share of the weighted cost that they explain together."""


class JointProblem:
    """The linearised problem of all candidates at the current model."""

    def __init__(
        self, comparison: ResidualModel, fitted: Fit, screened: Sequence[ScreenedCandidate]
    ) -> None:
        self.screened = [each for each in screened if each.signature is not None]
        weights = _weights(comparison, fitted.residual)
        weighted = replace(
            fitted,
            jacobian=fitted.jacobian * weights[:, None],
            residual=fitted.residual * weights,
        )
        known = CurrentFit.of(weighted)
        columns = [each.signature for each in self.screened if each.signature is not None]
        ends = np.cumsum([0, *(own.shape[1] for own in columns)])
        self._own = [np.arange(a, b) for a, b in itertools.pairwise(ends)]
        across, sizes, slope = self._products(columns, weights, known.jacobian, known.residual)
        self._known = len(known.slope)
        # the parameters' deviations from their priors are paid for as the residual is
        prior = max(fitted.cost - float(fitted.residual @ fitted.residual), 0.0)
        self._whole = float(known.residual @ known.residual) + prior
        self._noise = min(float(weights @ weights), self._whole)
        self._curvature = np.block([[known.curvature, across], [across.T, sizes]])
        self._slope = np.concatenate([known.slope, slope])
        shares = [each.shares for each, own in zip(self.screened, self._own, strict=True)
                  for _ in own]  # fmt: skip
        least, most = np.array(shares).T.reshape(2, -1)
        self._low = np.concatenate([known.room[0], least])
        self._high = np.concatenate([known.room[1], most])
        self._scale = np.sqrt(np.diag(self._curvature) + 1e-12)

    def _products(
        self, columns: Sequence[NDArray[np.float32]], weights: Array, known: Array, residual: Array
    ) -> tuple[Array, Array, Array]:
        """Products of the columns with sensitivities, with each other and the residual."""
        count = sum(own.shape[1] for own in columns)
        across, sizes = np.zeros((known.shape[1], count)), np.zeros((count, count))
        slope = np.zeros(count)
        for start in range(0, len(residual) if columns else 0, _ROWS):
            part = slice(start, start + _ROWS)
            rows = np.hstack([each[part] for each in columns]).astype(float)
            rows *= weights[part, None]
            across += known[part].T @ rows
            sizes += rows.T @ rows
            slope += rows.T @ residual[part]
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
        for gram, slope in (self._gram_parameters_fixed(), self._gram_parameters_free()):
            gain = self._gains(gram, slope, np.stack([first, second], axis=1))
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

    def better_than(self, chosen: tuple[int, ...]) -> list[Proposal]:
        """Sets that are worth more than some candidates (indices), the best first.

        One grows from these, the others from nothing.
        """
        own = self.solved(chosen)
        least = -np.inf if own is None else self._penalised_gain(own) + _PARAMETER
        found = [*self.greedy(), self._grown((), chosen)]
        real = [each for each in found if each is not None and self._penalised_gain(each) > least]
        return sorted(real, key=lambda each: -self._penalised_gain(each))

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

    def _grown(
        self, groups: Sequence[tuple[Key, tuple[int, ...]]], chosen: tuple[int, ...] = ()
    ) -> Proposal | None:
        """Set that grows by one candidate, or one of some groups (indices), at a time.

        The step is taken that is worth most. Where no further candidate is worth it, one of the
        set is exchanged for another, and it may grow again: the first members were chosen for what
        they explain of all that is missing, and the rest has come since.
        """
        best = self.solved(chosen)
        while True:
            better = None
            if len(chosen) < _GREEDY:
                steps = (*self._singles(chosen), *self._kind_groups(chosen, groups))
                better = self._best_of([(*chosen, *own) for own in steps], best)
            better = better or self._best_of(self._swaps(chosen), best)
            if better is None:
                return best
            chosen, best = better

    def _best_of(
        self, sets: Sequence[tuple[int, ...]], best: Proposal | None
    ) -> tuple[tuple[int, ...], Proposal] | None:
        """Set (indices) that is worth most; None if none is worth more than the best so far."""
        found = [(own, each) for own in sets if (each := self.solved(own)) is not None]
        least = -np.inf if best is None else self._penalised_gain(best) + _PARAMETER
        found = [each for each in found if self._penalised_gain(each[1]) > least]
        return max(found, key=lambda each: self._penalised_gain(each[1]), default=None)

    def _penalised_gain(self, proposal: Proposal) -> float:
        """Fall of the logarithm of what is left, less what members and parameters have to bring.

        What is left is no less than the noise.
        """
        count = sum(len(member.effect.parameters) for member in proposal.members)
        left = max((1.0 - proposal.predicted) * self._whole, self._noise)
        return (
            -float(np.log(left / self._whole))
            - SHARE_IN_SET * len(proposal.members)
            - _PARAMETER * count
        )

    def _swaps(self, chosen: tuple[int, ...]) -> list[tuple[int, ...]]:
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
        for gram, slope in (
            self._gram_parameters_fixed(chosen),
            self._gram_parameters_free(chosen),
        ):
            gains = self._gains(gram, slope, np.arange(len(places))[:, None])
            gains = np.where(free, gains, 0.0)
            tried |= {int(k): None for k in np.argsort(-gains)[:_TRIED] if gains[k] > 0}
        return [(k,) for k in tried]

    def _kind_groups(
        self, chosen: tuple[int, ...], groups: Sequence[tuple[Key, tuple[int, ...]]]
    ) -> list[tuple[int, ...]]:
        """Groups of further kinds that gain most beside some candidates (indices)."""
        kinds = {self.screened[k].effect.kind for k in chosen}
        left = [own for (kind, _), own in groups if kind not in kinds]
        if not left:
            return []
        gram, slope = self._gram_parameters_free(chosen)
        gains = [float(self._gains(gram, slope, np.array([own]))[0]) for own in left]
        return [left[k] for k in np.argsort(gains)[::-1][:_TRIED]]

    def solved(self, chosen: tuple[int, ...]) -> Proposal | None:
        """Set of some candidates (indices), solved within all bounds; None if it gains nothing.

        Members that explain less than `SHARE_IN_SET` of what is left without them are left out.
        """
        while chosen:
            own = [*range(self._known), *self._columns(chosen)]
            slope, curvature = self._slope[own], self._curvature[np.ix_(own, own)]
            moved = bounded_step(curvature, slope, self._low[own], self._high[own])
            gain = -float(moved @ (2 * slope + curvature @ moved))
            ends = self._known + np.cumsum([0, *(len(self._own[k]) for k in chosen)])
            parts = [slice(a, b) for a, b in itertools.pairwise(ends)]
            # what the sum of squares loses if a member goes and nothing else moves
            own_gain = np.array([moved[p] @ curvature[p, p] @ moved[p] for p in parts])
            left = max(self._whole - gain, self._noise)
            weak = np.flatnonzero(own_gain < SHARE_IN_SET * (left + own_gain))
            if not len(weak):
                break
            worst = int(weak[np.argmin(own_gain[weak])])
            chosen = tuple(k for n, k in enumerate(chosen) if n != worst)
        if not chosen or gain <= 0:
            return None
        members = tuple(
            replace(self.screened[k], values=self.screened[k].at(moved[part]))
            for k, part in zip(chosen, parts, strict=True)
        )
        return Proposal(members=members, predicted=gain / self._whole)

    def _gains(self, gram: Array, slope: Array, sets: NDArray[np.intp]) -> Array:
        """Fall of the sum of squares with each of some sets of candidates (S, K), free (S,)."""
        widest = max((len(own) for own in self._own), default=1)
        padded = np.full((len(self._own), widest), -1)
        for k, own in enumerate(self._own):
            padded[k, : len(own)] = own
        columns = padded[sets].reshape(len(sets), widest * sets.shape[1])
        there = columns >= 0
        size = np.sqrt(np.maximum(np.diag(gram), 1e-12))
        scaled = gram / np.outer(size, size)
        within = scaled[columns[:, :, None], columns[:, None, :]]
        within = np.where(there[:, :, None] & there[:, None, :], within, 0.0)
        within = within + (_RIDGE + ~there)[:, :, None] * np.eye(columns.shape[1])
        along = np.where(there, (slope / size)[columns], 0.0)
        return np.asarray(np.sum(along * np.linalg.solve(within, along[..., None])[..., 0], axis=1))

    def _gram_parameters_fixed(self, chosen: tuple[int, ...] = ()) -> tuple[Array, Array]:
        """Gram matrix (K, K) and slope (K,) beside some candidates, the parameters held."""
        return self._schur_complement(self._columns(chosen))

    def _gram_parameters_free(self, chosen: tuple[int, ...] = ()) -> tuple[Array, Array]:
        """The same with the parameters free, without their bounds."""
        return self._schur_complement([*range(self._known), *self._columns(chosen)])

    def _columns(self, chosen: tuple[int, ...]) -> list[int]:
        return [self._known + int(c) for k in chosen for c in self._own[k]]

    def _schur_complement(self, own: list[int]) -> tuple[Array, Array]:
        """Gram matrix (K, K) and slope (K,) of the columns less what some numbers absorb."""
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


def _weights(comparison: ResidualModel, residual: Array) -> Array:
    """Weight of each row (N,): one over the root mean square of its channel, at most 1."""
    channel = comparison.rows.channel
    count = np.maximum(np.bincount(channel), 1)
    squares: NDArray[np.float64] = np.bincount(channel, residual**2) / count
    return np.asarray(1.0 / np.sqrt(np.maximum(squares, 1.0)))[channel]


def _place(each: ScreenedCandidate) -> Key:
    """Kind and location: variants and starts of one effect are alternatives."""
    return each.effect.kind, each.effect.where


def _best(found: Sequence[Proposal | None], most: int) -> list[Proposal]:
    """Proposals of two members or more, the best first, none twice."""
    kept: dict[frozenset[tuple[str, str]], Proposal] = {}
    real = (each for each in found if each is not None and len(each.members) > 1)
    for each in sorted(real, key=lambda proposal: -proposal.predicted):
        kept.setdefault(frozenset(_place(member) for member in each.members), each)
    return list(kept.values())[:most]
