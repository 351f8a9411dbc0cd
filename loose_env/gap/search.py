"""The search for what is missing, beside stops a second time, with what these leave as noise.

No law of contact is that of the machine, so that a part which strikes its stops leaves
accelerations many times louder than their noise. What else is missing is slight beside that: it
would be passed over, or something loud and wrong be named in its place. So the search goes on with
each channel's noise as large as what is left in it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from loose_env.gap.ambiguity import indistinct
from loose_env.gap.comparison import Comparison
from loose_env.gap.effect import Effect
from loose_env.gap.fit import cost_of, parameters_of
from loose_env.gap.judgement import Judge, Judged
from loose_env.gap.naming import Keep, Named, name_effects
from loose_env.gap.naming_settings import NamingSettings
from loose_env.gap.preparing import Prepared
from loose_env.gap.ranking import ranking_of
from loose_env.gap.result import Ranked

__all__ = ["Searched", "search"]

Array = NDArray[np.float64]

_EVERYWHERE = 5.0
"""`NamingSettings.everywhere` beside stops: of what these leave nothing slight explains much, and
what is slight and there shows in nearly every block of time, which what stands in does not."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Searched:
    """What a search found."""

    prepared: Prepared
    """The runs."""
    heard: Prepared
    """The same, with the noise by which the last of the searches went."""
    parts: tuple[Named, ...]
    """The search, and the one that went on beside stops, if any."""

    @property
    def named(self) -> Named:
        """The last search."""
        return self.parts[-1]

    @property
    def base(self) -> Judged:
        """The nominal model, by the noise there is."""
        return self.parts[0].base

    @property
    def best(self) -> Judged:
        """What was found, by the noise of `heard`."""
        return self.named.best

    @property
    def ranking(self) -> tuple[Ranked, ...]:
        """What was tried, step by step, by the noise there is."""
        found = ranking_of(self.parts[0], self.prepared.search, self.prepared.held)
        if len(self.parts) > 1:
            runs = self.heard.search, self.heard.held
            louder = _times(self.heard.held, self.prepared.held)
            found += ranking_of(self.parts[1], *runs, louder=louder, first=len(self.parts[0].steps))
        return found

    def indistinct(self, effect: Effect) -> tuple[Effect, ...]:
        """What held-out runs cannot tell from an effect."""
        found = chain(*(indistinct(named, effect) for named in self.parts))
        there = {(e.kind, e.where) for e in self.best.fitted.named}
        others = {(e.kind, e.where): e for e in found}
        return tuple(e for place, e in others.items() if place not in there)

    def in_noise(self, best: Judged) -> Judged:
        """A fit to ``heard.fit`` as the noise there is judges it; nothing is fitted again."""
        if self.heard is self.prepared:
            return best
        louder = _times(self.heard.fit, self.prepared.fit)
        return _judged_by(Judge(self.prepared.fit, self.prepared.whole_held), best, louder)


def search(
    prepared: Prepared,
    given: Sequence[Effect],
    sought: Sequence[Effect],
    *,
    settings: NamingSettings,
    say: Callable[[str], None] = lambda _: None,
    keep: Keep | None = None,
    keep_beside: Keep | None = None,
) -> Searched:
    """Search for what a model lacks.

    Parameters
    ----------
    prepared : Prepared
        The runs.
    given, sought, settings, say, keep
        As of `loose_env.gap.naming.name_effects`, ``sought`` being its candidates.
    keep_beside : Keep, optional
        Keeps what the second search finds.
    """
    runs = prepared.search, prepared.held
    found = name_effects(*runs, given, sought, settings=settings, say=say, keep=keep)
    if not found.unfinished:
        return Searched(prepared=prepared, heard=prepared, parts=(found,))
    left = prepared.search.left_in_channels(found.best.fitted.residual)
    say("goes on with what its stops leave as noise")
    heard = prepared.louder(np.maximum(left, 1.0))
    judge = Judge(heard.search, heard.held)
    softer = 1.0 / _times(heard.search, prepared.search)
    more = name_effects(
        heard.search,
        heard.held,
        given,
        sought,
        settings=replace(settings, everywhere=_EVERYWHERE),
        say=say,
        keep=keep_beside,
        begun=(_judged_by(judge, found.base, softer), _judged_by(judge, found.best, softer)),
    )
    return Searched(prepared=prepared, heard=heard, parts=(found, more))


def _judged_by(judge: Judge, judged: Judged, times: Array) -> Judged:
    """A fit as other noise judges it, in which residuals are so many times as large (N,)."""
    fitted = judged.fitted
    residual = judge.comparison.residuals([fitted.hypothesis])[0]
    return judge.judge(
        replace(
            fitted,
            residual=residual,
            jacobian=fitted.jacobian * times[:, None],
            cost=cost_of(residual, fitted.free, parameters_of(fitted.effects)),
        )
    )


def _times(louder: Comparison, runs: Comparison) -> Array:
    """How many times as large noise is in one for each number of the same runs (N,).

    Features go by their own scatter, however loud the channels that they are made of.
    """
    found: Array = (louder.scales / runs.scales)[runs.rows.trial, runs.rows.channel]
    found[runs.rows.white] = 1.0
    return found
