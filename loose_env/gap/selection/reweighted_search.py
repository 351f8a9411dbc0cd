"""Effect search with noise reweighted by the residual of impact-dominated parts.

No contact law matches the machine exactly, so that a part hitting its stops has acceleration
residuals many times larger than the noise. Other missing effects are small beside them: they would
be missed, or a large but wrong effect be identified instead. The search therefore continues with
each channel's noise set to its residual, updated with each identified effect.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import chain, count

import numpy as np

from loose_env.gap.fitting.gauss_newton import cost_of
from loose_env.gap.fitting.holdout_score import Judge, Judged
from loose_env.gap.fitting.model_structure import Nuisance
from loose_env.gap.model.effect import Effect, have_stops
from loose_env.gap.output.result import Ranked
from loose_env.gap.preparation.prepare import GapProblem
from loose_env.gap.residuals.residual_model import Comparison
from loose_env.gap.selection.forward_selection import Keep, Named, name_effects
from loose_env.gap.selection.ranking import indistinct, ranking_of
from loose_env.gap.settings import (
    IMPACT_RMS,
    SUFFICIENT_Z,
    SearchSettings,
)
from loose_env.typing import Array

__all__ = ["Searched", "beside_stops", "search"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Searched:
    """Result of a search."""

    prepared: GapProblem
    """The runs."""
    parts: tuple[tuple[GapProblem, Named], ...]
    """The search and its continuations beside stops, each with the noise used."""

    @property
    def named(self) -> Named:
        """The last part of the search."""
        return self.parts[-1][1]

    @property
    def heard(self) -> GapProblem:
        """The runs with the noise used in the last part."""
        return self.parts[-1][0]

    @property
    def base(self) -> Judged:
        """The nominal model, scored with the current noise."""
        return self.parts[0][1].base

    @property
    def best(self) -> Judged:
        """The best hypothesis, scored with the noise of `heard`."""
        return self.named.best

    @property
    def ranking(self) -> tuple[Ranked, ...]:
        """Ranking of all fits, step by step; held-out residuals use the current noise."""
        found: list[Ranked] = []
        first = 1
        for runs, named in self.parts:
            louder = _times(runs.held, self.prepared.held)
            found += ranking_of(named, runs.search, runs.held, louder=louder, first=first)
            first += len(named.steps) - 1
        return tuple(found)

    def indistinct(self, effect: Effect, named: Sequence[Effect]) -> tuple[Effect, ...]:
        """Effects that held-out runs cannot distinguish from an identified one."""
        found = chain(*(indistinct(part, effect) for _, part in self.parts))
        there = {(e.kind, e.where) for e in named}
        others = {(e.kind, e.where): e for e in found}
        return tuple(e for place, e in others.items() if place not in there)

    def in_noise(self, best: Judged) -> Judged:
        """Score a fit to ``heard.fit`` with the current noise, without refitting."""
        return _judged_by(self.prepared.fit, self.prepared.whole_held, self.heard.fit, best)


def search(
    prepared: GapProblem,
    nuisance: Nuisance,
    sought: Sequence[Effect],
    *,
    settings: SearchSettings,
    say: Callable[[str], None] = lambda _: None,
    keep: Callable[[str], Keep] = lambda _: Keep(),
) -> Searched:
    """Search for effects that a model lacks.

    Parameters
    ----------
    prepared : GapProblem
        The runs.
    nuisance, sought, settings, say
        As of `loose_env.gap.selection.forward_selection.name_effects`, ``sought`` being its
        candidates.
    keep : callable
        Maps a prefix to the checkpoints of a part of the search.
    """

    def left(judged: Judged) -> Array:
        return prepared.search.left_in_channels(judged.fitted.residual)

    def stops_leave(judged: Judged) -> bool:
        return have_stops(judged.fitted.effects) and bool(left(judged).max() > IMPACT_RMS)

    heard, own, pause, begun = prepared, settings, stops_leave, None
    parts: list[tuple[GapProblem, Named]] = []
    # terminates: each unfinished part either identifies one more effect or drops one for good
    for number in count(1):
        named = name_effects(
            heard.search,
            heard.held,
            nuisance,
            sought,
            settings=own,
            say=say,
            keep=keep(f"part-{number}-" if number > 1 else ""),
            begun=begun,
            pause=pause,
        )
        parts.append((heard, named))
        if not named.unfinished:
            break
        # with the current noise, as the last identified effect may have reduced the residual of the
        # stops
        best = _judged_by(prepared.search, prepared.held, heard.search, named.best)
        if stops_leave(best):
            say("goes on with what its stops leave as noise")
            heard, own = prepared.louder(np.maximum(left(best), 1.0)), beside_stops(settings)
        else:
            heard, own = prepared, settings
        # any further effect changes the residual
        pause = stops_leave if heard is prepared else _always
        base = parts[0][1].base
        base, best = (
            _judged_by(heard.search, heard.held, prepared.search, each) for each in (base, best)
        )
        begun = Named(base=base, steps=[best], dropped=named.dropped)
    return Searched(prepared=prepared, parts=tuple(parts))


def beside_stops(settings: SearchSettings) -> SearchSettings:
    """Acceptance criteria where the residual of stops counts as noise."""
    return replace(settings, sufficient_z=SUFFICIENT_Z, swap_stops=False)


def _always(judged: Judged) -> bool:
    return True


def _judged_by(runs: Comparison, held: Comparison, own: Comparison, judged: Judged) -> Judged:
    """Score a fit on its own runs and on held-out runs with the noise of those runs."""
    if runs is own:
        return judged
    fitted = judged.fitted
    residual = runs.residuals([fitted.hypothesis])[0]
    return Judge(runs, held).judge(
        replace(
            fitted,
            residual=residual,
            jacobian=fitted.jacobian * _times(own, runs)[:, None],
            cost=cost_of(residual, fitted.free, fitted.structure.parameters),
        )
    )


def _times(own: Comparison, runs: Comparison) -> Array:
    """Ratio of the noise of two comparisons, for each number of the same runs (N,).

    Features use their own standard deviation, however noisy the channels they are computed from.
    """
    found: Array = (own.scales / runs.scales)[runs.rows.trial, runs.rows.channel]
    found[runs.rows.white] = 1.0
    return found
