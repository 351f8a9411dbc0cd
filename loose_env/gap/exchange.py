"""Tries what looks like a named effect in its place, once the others are there.

A search that adds one effect after the other names the first one by a gap that is that of several.
What stood in best for the mixture may have a better rival, or need fewer effects beside it, when
the others are in the model.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from loose_env.gap.acceptance import Acceptance
from loose_env.gap.comparison import Comparison
from loose_env.gap.effect import Effect
from loose_env.gap.fit import UNNAMED, fit_without, polished
from loose_env.gap.judgement import Judge, Judged, lead_of
from loose_env.gap.kinship import akin
from loose_env.gap.naming_settings import NamingSettings
from loose_env.gap.screening import screen
from loose_env.gap.trying import Trying

__all__ = ["exchanged"]


def exchanged(
    comparisons: tuple[Comparison, Comparison],
    judge: Judge,
    candidates: Sequence[Effect],
    base: Judged,
    best: Judged,
    settings: NamingSettings,
    say: Callable[[str], None] = lambda _: None,
) -> Judged:
    """Exchange named effects for such as they may be mistaken for, where that is better.

    A hypothesis takes the place of another if it would have been ranked above it: it leaves less,
    or it does as well with fewer parameters.

    Parameters
    ----------
    comparisons : tuple of Comparison
        The runs to fit to, and the windows of them that sort candidates.
    judge : Judge
        Judges what was fitted to all data.
    candidates : sequence of Effect
        The catalogue at every place.
    base, best : Judged
        The nominal model, and what was found.
    settings : NamingSettings
        How many are tried: `NamingSettings.exchanged` at most are looked at for each effect.
    say : callable
        Told what goes on, line by line.

    Returns
    -------
    Judged
        ``best`` itself where nothing is better.
    """
    for effect in _named(best):
        if not any(effect is each for each in best.fitted.effects):
            continue  # one that an exchange made idle
        better = _in_place_of(effect, comparisons, judge, candidates, base, best, settings)
        if better is not None:
            say(
                f"  {', '.join(map(repr, _named(best)))}: as well or better, and simpler, as "
                f"{', '.join(map(repr, _named(better)))}"
            )
            best = better
    return best


def _in_place_of(
    effect: Effect,
    comparisons: tuple[Comparison, Comparison],
    judge: Judge,
    candidates: Sequence[Effect],
    base: Judged,
    best: Judged,
    settings: NamingSettings,
) -> Judged | None:
    """The best hypothesis with another effect in the place of one; None if none is better."""
    comparison, short = comparisons
    taken = {(e.kind, e.where) for e in best.fitted.effects}
    kin = [c for c in candidates if akin(effect, c) and (c.kind, c.where) not in taken]
    if not kin:
        return None
    before = judge.judge(fit_without(comparison, best.fitted, effect))
    trying = Trying(comparison, short, judge, before, settings)
    acceptance = Acceptance(comparison, judge, base, before, settings)
    screened = screen(short, trying.short_before, kin)[: settings.exchanged]
    for judged in trying.in_place(screened, best.fitted):
        simpler = _without_idle(judged, before, best, comparison, judge, acceptance)
        if acceptance.ranked([best, simpler])[0] is not simpler:
            continue
        if acceptance.ahead_of_its_limit(judged) and acceptance.above_the_noise(judged):
            return judge.judge(polished(comparison, simpler.fitted))
    return None


def _without_idle(
    judged: Judged,
    before: Judged,
    best: Judged,
    comparison: Comparison,
    judge: Judge,
    acceptance: Acceptance,
) -> Judged:
    """A hypothesis without the effects that its new one makes idle."""
    for other in _named(before):
        without = judge.judge(fit_without(comparison, judged.fitted, other))
        needed = acceptance.believed(lead_of(judged, without))
        if not needed and not acceptance.believed(lead_of(best, without)):
            judged = without
    return judged


def _named(judged: Judged) -> list[Effect]:
    return [e for e in judged.fitted.effects if e.kind not in UNNAMED]
