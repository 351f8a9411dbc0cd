"""Names what a model lacks: screening, fits from several starts, held-out runs as the judge."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from loose_env.gap.comparison import Comparison
from loose_env.gap.effect import Effect
from loose_env.gap.families import families
from loose_env.gap.fit import (
    UNNAMED,
    Fit,
    cost_of,
    fit,
    fit_without,
    hypothesis_of,
    parameters_of,
    polished,
    refined,
    slices_of,
    started,
)
from loose_env.gap.judgement import Judge, Judged, Lead, lead_of
from loose_env.gap.kinship import akin
from loose_env.gap.lighter import lighter
from loose_env.gap.parameter import free_of, values_of
from loose_env.gap.proposals import proposals
from loose_env.gap.screening import Screened, screen
from loose_env.gap.windows import windowed

__all__ = ["Keep", "Named", "NamingSettings", "Step", "name_effects"]

Array = NDArray[np.float64]
Say = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class NamingSettings:
    """When an effect counts as found."""

    most: int = 3
    """Most effects named."""
    sorting: float = 10.0
    """How much of the runs is used to sort candidates, in all [s]."""
    candidates: int = 7
    """Candidates that are fitted to that."""
    finalists: int = 3
    """Candidates that are fitted to whole runs."""
    kin: int = 2
    """Further candidates fitted to whole runs because the best one may be mistaken for them."""
    alone: float = 0.5
    """Share of what is still to be explained below which no effect by itself will do, and one kind
    at several places is tried."""
    families: int = 6
    """Kinds that are tried at several places."""
    promise: float = 0.1
    """Share of the best candidate's promise from which on another is fitted too."""
    structure: float = 3.0
    """Sureness with which a residual has to hang together in time for anything to be sought in
    it [standard deviations]."""
    sureness: float = 3.5
    """Lead from which on an effect is believed, on the runs fitted to or on those held out
    [standard deviations]."""
    held: float = 2.0
    """Lead that it needs on either."""
    share: float = 0.4
    """Share of what is still to be explained that it has to explain; or else:"""
    base_share: float = 0.04
    """Share of what there was to explain at first that it has to explain; or else:"""
    channel_share: float = 0.3
    """Share of what there was to explain at first in one channel in which it hung together surely
    (`channel_sureness`)."""
    channel_sureness: float = 10.0
    """Mean product of a residual of that channel with itself a little later, over what white
    noise shows by chance [standard deviations]."""
    worth: float = 0.02
    """Share of the sum of squares below which further parameters are of little worth."""
    more: float = 0.1
    """Share of what a simpler hypothesis leaves that they have to explain even so."""
    tie: float = 2.0
    """Lead on held-out runs below which two hypotheses cannot be told apart."""


@dataclass(kw_only=True, eq=False)
class Named:
    """What was found, step by step."""

    base: Judged
    """The nominal model, fitted within the tolerance."""
    steps: list[Judged] = field(default_factory=list)
    """With one effect, with two, ...: the accepted ones."""
    rivals: list[list[tuple[Judged, Lead]]] = field(default_factory=list)
    """At each step, every hypothesis that was fitted, with its lead over the step before; best
    first."""

    dropped: list[Effect] = field(default_factory=list)
    """Effects that a later one made idle."""

    @property
    def best(self) -> Judged:
        """The last that was accepted."""
        return self.steps[-1] if self.steps else self.base


@dataclass(frozen=True, kw_only=True, eq=False)
class Step:
    """What the search for one more effect came to."""

    rivals: list[Judged]
    """Every hypothesis that was fitted to whole runs, best first."""
    accepted: Judged | None
    """The one that was believed, with fresh sensitivities."""
    dropped: list[Effect] = field(default_factory=list)
    """Earlier effects that it made idle."""


class Keep:
    """Makes what the search asks for; a subclass may keep it for an interrupted run."""

    def judged(self, name: str, make: Callable[[], Judged]) -> Judged:
        """Return a judged fit."""
        return make()

    def step(self, name: str, make: Callable[[], Step]) -> Step:
        """Return a step of the search."""
        return make()


def name_effects(
    comparison: Comparison,
    held_out: Comparison,
    given: Sequence[Effect],
    candidates: Sequence[Effect],
    *,
    settings: NamingSettings | None = None,
    say: Say = lambda _: None,
    keep: Keep | None = None,
) -> Named:
    """Add effects to a nominal model as long as held-out runs ask for it.

    Parameters
    ----------
    comparison, held_out : Comparison
        The runs to fit to, and those to judge by.
    given : sequence of Effect
        What is fitted with every hypothesis: the nominal figures, known within a tolerance, and the
        starts of free runs.
    candidates : sequence of Effect
        The catalogue at every place.
    settings : NamingSettings, optional
        When an effect counts as found.
    say : callable
        Told what goes on, line by line.
    keep : Keep, optional
        Keeps what was found for a run that is interrupted.
    """
    settings, keep = settings or NamingSettings(), keep or Keep()
    start = np.concatenate([free_of(e.parameters, np.array(e.starts[0])) for e in given])
    judge = Judge(comparison, held_out)
    base = keep.judged("nominal", lambda: judge.judge(fit(comparison, given, start)))
    found = Named(base=base)
    say(f"nominal model: {base.held_rms:.2f} noise standard deviations on held-out runs")
    short = windowed(comparison, settings.sorting)
    for number in range(1, settings.most + 1):
        if sum(e.kind not in UNNAMED for e in found.best.fitted.effects) >= settings.most:
            break
        if found.best.structure_sureness < settings.structure:
            say("what is left does not hang together in time: nothing more to explain")
            break
        step = keep.step(
            f"effect-{number}",
            lambda: _step(comparison, short, judge, candidates, found, settings, say),
        )
        found.rivals.append([(j, lead_of(j, found.best)) for j in step.rivals])
        for judged, lead in found.rivals[-1]:
            new = judged.fitted.effects[len(found.best.fitted.effects) :]
            say(
                f"  {', '.join(map(repr, new))}: held out {judged.held_rms:.3f}, "
                f"lead {lead.held:.1f} held, {lead.fitted:.1f} fitted, share {lead.share:.2f}"
            )
        if step.accepted is None:
            break
        for effect in step.dropped:
            say(f"  {effect!r} is idle now and is left out")
        found.steps.append(step.accepted)
        found.dropped += step.dropped
    return found


def _step(
    comparison: Comparison,
    short: Comparison,
    judge: Judge,
    candidates: Sequence[Effect],
    found: Named,
    settings: NamingSettings,
    say: Say,
) -> Step:
    """Look for one more effect."""
    taken = {(e.kind, e.where) for e in (*found.best.fitted.effects, *found.dropped)}
    left = [c for c in candidates if (c.kind, c.where) not in taken]
    before = _on(short, found.best.fitted)
    proposed = proposals(comparison, found.best.fitted.hypothesis, left)
    screened = screen(short, before, left, light=lighter(short), proposed=proposed)
    for s in screened[:8]:
        say(f"  {s.effect!r}: promises {s.promise:.3f}, sureness {s.sureness:.1f}")
    tried = _try(comparison, (short, before), judge, found.best, screened, settings)
    if all(lead_of(j, found.best).share < settings.alone for j in tried):
        say("  no single effect explains much: the same one at several places")
        tried += _try_families(comparison, (short, before), judge, found.best, screened, settings)
    ranked = _simplest_first(sorted(tried, key=lambda j: j.total), settings)
    for judged in ranked:
        lead = lead_of(judged, found.best)
        if _believed(lead, settings) and _material(judged, lead, found, settings):
            if not _ahead_of_its_limit(comparison, judge, judged, found.best, settings):
                say(f"  {judged.fitted.effects[-1]!r}: no better than if it were rigid")
                continue
            new = len(judged.fitted.effects) - len(found.best.fitted.effects)
            best = judge.judge(polished(comparison, judged.fitted))
            pruned = _prune(comparison, judge, best, new, settings)
            earlier = len(found.best.fitted.effects)
            accepted, dropped = _drop(comparison, judge, pruned, earlier, settings)
            return Step(rivals=ranked, accepted=accepted, dropped=dropped)
    return Step(rivals=ranked, accepted=None)


def _ahead_of_its_limit(
    comparison: Comparison, judge: Judge, judged: Judged, before: Judged, settings: NamingSettings
) -> bool:
    """Whether an effect explains more than the way in which it is simulated.

    One that adds motion is simulated by another route than the rigid arm, above all backwards. It
    has to be ahead of itself at the limit in which nothing moves, too.
    """
    effect, fitted = judged.fitted.effects[-1], judged.fitted
    if effect.limit is None or len(fitted.effects) != len(before.fitted.effects) + 1:
        return True
    own = slices_of(fitted.effects)[-1]
    free = np.concatenate([before.fitted.free, fitted.free[own]])
    values = effect.at_limit(values_of(effect.parameters, fitted.free[own]))
    free[own] = free_of(effect.parameters, values)
    residual = comparison.residuals([hypothesis_of(fitted.effects, free)])[0]
    rigid = judge.judge(replace(fitted, free=free, residual=residual))
    return _believed(lead_of(judged, rigid), settings)


def _prune(
    comparison: Comparison, judge: Judge, judged: Judged, new: int, settings: NamingSettings
) -> Judged:
    """Take out those of several new effects that are not believed by themselves."""
    while new > 1:
        without = [
            judge.judge(fit_without(comparison, judged.fitted, effect))
            for effect in judged.fitted.effects[-new:]
        ]
        leads = [lead_of(judged, each) for each in without]
        weakest = min(range(new), key=lambda k: leads[k].fitted + leads[k].held)
        if _believed(leads[weakest], settings):
            break
        judged, new = without[weakest], new - 1
    return judged


def _simplest_first(ranked: list[Judged], settings: NamingSettings) -> list[Judged]:
    """Ranked hypotheses; one with fewer parameters goes before the best if that is not ahead.

    More parameters fit a little better everywhere, surely and to no purpose: the best has to
    explain some of what the simpler one leaves, and there has to be something left.
    """
    for judged in sorted(ranked[1:], key=lambda j: j.free_count):
        if judged.free_count >= ranked[0].free_count:
            break
        lead = lead_of(ranked[0], judged)
        chance = lead.held < settings.tie and lead.fitted < settings.tie
        small = abs(ranked[0].total - judged.total) < settings.worth * ranked[0].total
        whole = judged.structure_sureness < settings.structure
        if chance or (small and (whole or lead.share < settings.more)):
            return [judged, *(j for j in ranked if j is not judged)]
    return ranked


def _believed(lead: Lead, settings: NamingSettings) -> bool:
    """Whether a lead is no chance: seen in both halves of the data, and surely in one."""
    return (
        min(lead.fitted, lead.held) >= settings.held
        and max(lead.fitted, lead.held) >= settings.sureness
    )


def _material(judged: Judged, lead: Lead, found: Named, settings: NamingSettings) -> bool:
    """Whether an effect explains enough: a law that is a little wrong leaves room for many."""
    gained = found.best.structure - judged.structure
    if lead.share >= settings.share or gained >= settings.base_share * found.base.structure:
        return True
    # A machine may lack something at every joint: what is little of all may be much of a channel.
    base, count = found.base.channel_structure
    sure = base > settings.channel_sureness * np.sqrt(count)
    by_channel = found.best.channel_structure[0] - judged.channel_structure[0]
    return bool(np.any(sure & (by_channel >= settings.channel_share * base)))


def _drop(
    comparison: Comparison, judge: Judge, judged: Judged, earlier: int, settings: NamingSettings
) -> tuple[Judged, list[Effect]]:
    """Take out the first earlier effect that the latest ones have made idle, if any is."""
    for effect in judged.fitted.effects[:earlier]:
        if effect.kind in UNNAMED:
            continue
        without = judge.judge(fit_without(comparison, judged.fitted, effect))
        lead = lead_of(judged, without)
        if not _believed(lead, settings):
            return without, [effect]
    return judged, []


def _on(short: Comparison, fitted: Fit) -> Fit:
    """A fit as it looks on the windows that sort candidates, with sensitivities of its own."""
    residual = short.residuals([fitted.hypothesis])[0]
    moved = replace(
        fitted,
        residual=residual,
        cost=cost_of(residual, fitted.free, parameters_of(fitted.effects)),
    )
    return refined(moved, short)


def _try_families(
    comparison: Comparison,
    windows: tuple[Comparison, Fit],
    judge: Judge,
    before: Judged,
    screened: Sequence[Screened],
    settings: NamingSettings,
) -> list[Judged]:
    """Fit one kind of effect at several places at once, the best of them to all data."""
    short, short_before = windows
    sorted_out: list[Fit] = []
    for members in families(screened, settings.families):
        start = short_before.free
        for each in members:
            start = np.concatenate([start, free_of(each.effect.parameters, np.array(each.values))])
        effects = (*before.fitted.effects, *(each.effect for each in members))
        sorted_out.append(fit(short, effects, start, known=short_before.jacobian))
    sorted_out.sort(key=lambda f: f.cost)
    return [_whole(comparison, judge, before, each) for each in sorted_out[:2]]


def _try(
    comparison: Comparison,
    windows: tuple[Comparison, Fit],
    judge: Judge,
    before: Judged,
    screened: Sequence[Screened],
    settings: NamingSettings,
) -> list[Judged]:
    """Fit the most promising candidates on top of what is there, the best of them to all data."""
    if not screened:
        return []
    short, short_before = windows
    least = settings.promise * screened[0].promise
    sorted_out: list[Fit] = []
    for each in screened[: settings.candidates]:
        if each.promise < least:
            break
        effects = (*before.fitted.effects, each.effect)
        start = started(short_before, each.effect, each.values)
        sorted_out.append(fit(short, effects, start, known=short_before.jacobian))
    sorted_out.sort(key=lambda f: f.cost)
    found = [_whole(comparison, judge, before, f) for f in sorted_out[: settings.finalists]]
    winner = min(found, key=lambda j: j.total).fitted.effects[-1]
    kin = [f for f in sorted_out[settings.finalists :] if akin(winner, f.effects[-1])]
    return found + [_whole(comparison, judge, before, f) for f in kin[: settings.kin]]


def _whole(comparison: Comparison, judge: Judge, before: Judged, each: Fit) -> Judged:
    """Fit to all data what was fitted to windows of it."""
    start = np.concatenate([before.fitted.free, each.free[len(before.fitted.free) :]])
    return judge.judge(fit(comparison, each.effects, start, known=before.fitted.jacobian))
