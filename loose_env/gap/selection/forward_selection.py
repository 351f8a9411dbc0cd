"""Forward selection of effects: screening, multi-start fits, held-out validation."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

from loose_env.gap.fitting.gauss_newton import fit
from loose_env.gap.fitting.holdout_score import Judge, Judged, Lead, lead_of
from loose_env.gap.fitting.model_structure import ModelStructure, Nuisance
from loose_env.gap.fitting.refit import fitted_on
from loose_env.gap.model.effect import Effect, have_stops
from loose_env.gap.residuals.residual_model import Comparison
from loose_env.gap.residuals.windows import SHORTEST, windowed
from loose_env.gap.selection.acceptance import Acceptance
from loose_env.gap.selection.candidate_fits import Trying
from loose_env.gap.selection.revision import Exchange
from loose_env.gap.selection.screening.data_driven_starts import proposals
from loose_env.gap.selection.screening.grouping import frictions
from loose_env.gap.selection.screening.screening import screen
from loose_env.gap.settings import (
    FAMILY_LOCATIONS,
    FAMILY_SHARE,
    LARGE_RESIDUAL,
    LARGE_RMS,
    NOISE_RMS,
    SCREENING_RUNS,
    SCREENING_S,
    SEARCH_Z,
    SINGLE_SHARE,
    SWAPPED_EFFECTS,
    SearchSettings,
)

__all__ = ["Keep", "Named", "Step", "name_effects"]

Say = Callable[[str], None]


@dataclass(kw_only=True, eq=False)
class Named:
    """Result of a forward selection, step by step."""

    base: Judged
    """The nominal model, fitted within the tolerance."""
    steps: list[Judged] = field(default_factory=list)
    """The accepted hypotheses, with one effect, with two, ..."""
    rivals: list[list[tuple[Judged, Lead]]] = field(default_factory=list)
    """At each step, every hypothesis that was fitted, with its improvement over the step before;
    best first."""

    dropped: list[Effect] = field(default_factory=list)
    """Effects that a later one made insignificant."""
    unfinished: bool = False
    """Whether the search stopped after a step on request."""

    @property
    def best(self) -> Judged:
        """The last accepted hypothesis."""
        return self.steps[-1] if self.steps else self.base


@dataclass(frozen=True, kw_only=True, eq=False)
class Step:
    """Result of the search for one more effect."""

    rivals: list[Judged]
    """Every hypothesis that was fitted to whole runs, best first."""
    accepted: Judged | None
    """The accepted hypothesis, with fresh sensitivities."""
    dropped: list[Effect] = field(default_factory=list)
    """Earlier effects that it made insignificant."""


class Keep:
    """Computes the fits and steps of a search; subclasses may checkpoint them."""

    def judged(self, name: str, make: Callable[[], Judged]) -> Judged:
        """Return a scored fit."""
        return make()

    def step(self, name: str, make: Callable[[], Step]) -> Step:
        """Return a step of the search."""
        return make()


def name_effects(
    comparison: Comparison,
    held_out: Comparison,
    nuisance: Nuisance,
    candidates: Sequence[Effect],
    *,
    settings: SearchSettings | None = None,
    say: Say = lambda _: None,
    keep: Keep | None = None,
    begun: Named | None = None,
    pause: Callable[[Judged], bool] = lambda _: False,
) -> Named:
    """Add effects to a nominal model by forward selection with held-out validation.

    Parameters
    ----------
    comparison, held_out : Comparison
        The training runs and the held-out runs.
    nuisance : Nuisance
        Nuisance parameters, fitted with every hypothesis.
    candidates : sequence of Effect
        The catalogue at every location.
    settings : SearchSettings, optional
        Acceptance criteria for an effect.
    say : callable
        Receives progress messages, line by line.
    keep : Keep, optional
        Checkpoints of the search, for resuming an interrupted run.
    begun : Named, optional
        An earlier search, scored on these runs; its effects are refitted to them, and the search
        goes on from there.
    pause : callable
        Receives the result after each step; the search stops, unfinished, if it returns true.
    """
    settings, keep = settings or SearchSettings(), keep or Keep()
    judge = Judge(comparison, held_out)
    if begun is None:
        nominal = ModelStructure(nuisance=nuisance)
        base = keep.judged(
            "nominal", lambda: judge.judge(fit(comparison, nominal, nominal.nominal_start))
        )
        found = Named(base=base)
        say(f"nominal model: {base.held_rms:.2f} noise standard deviations on held-out runs")
    else:
        there = begun.best.fitted
        found = Named(base=begun.base, dropped=list(begun.dropped))
        found.steps.append(keep.judged("begun", lambda: judge.judge(fitted_on(comparison, there))))
        found.rivals.append([])
    windows = SHORTEST * min(len(comparison.trials), SCREENING_RUNS)
    short = windowed(comparison, max(SCREENING_S, windows))
    for number in range(1, settings.most_effects + 1):
        if len(found.best.fitted.effects) >= settings.most_effects:
            break
        if found.best.structure_sureness < SEARCH_Z and not found.best.loud:
            say("what is left does not hang together in time: nothing more to explain")
            break
        step = keep.step(
            f"effect-{number}",
            lambda: _step((comparison, short), judge, candidates, found, settings, say),
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
        if len(found.best.fitted.effects) < settings.most_effects and pause(found.best):
            found.unfinished = True
            return found
    if 2 <= len(found.best.fitted.effects) <= SWAPPED_EFFECTS:
        say("whether others do as well in the place of what was found")
        exchange = Exchange(comparison, short, judge, candidates, found.base, settings)
        better = keep.judged("exchanged", lambda: exchange.better_than(found.best, say))
        if _keys(better) != _keys(found.best):
            found.steps.append(better)
    return found


def _keys(judged: Judged) -> set[tuple[str, str, str]]:
    return {effect.key for effect in judged.fitted.effects}


def _step(
    comparisons: tuple[Comparison, Comparison],
    judge: Judge,
    candidates: Sequence[Effect],
    found: Named,
    settings: SearchSettings,
    say: Say,
) -> Step:
    """Search for one more effect."""
    comparison, short = comparisons
    best = found.best
    taken = {(e.kind, e.where) for e in (*best.fitted.effects, *found.dropped)}
    left = [c for c in candidates if (c.kind, c.where) not in taken]
    trying = Trying(comparison, short, judge, best)
    proposed = proposals(comparison, best.fitted.hypothesis, left)
    screened = screen(short, trying.short_before, left, proposed=proposed)
    for s in screened[:8]:
        say(f"  {s.effect!r}: promises {s.promise:.3f}, sureness {s.sureness:.1f}")
    much = best.structure > LARGE_RESIDUAL * found.base.structure or best.held_rms > LARGE_RMS
    much = much and not have_stops(best.fitted.effects)  # each additional fit takes minutes there

    def waves() -> Iterator[list[Judged]]:
        """Generate candidate fits in stages, until one is accepted."""
        wave = trying.singles(screened)
        tried = wave.scored
        if much and all(lead_of(j, best).share < SINGLE_SHARE for j in tried):
            say("  no single effect explains much: the same one at several places")
            wave = trying.families(screened, wave.best)
            tried += wave.scored
        elif much:
            first = min(tried, key=lambda j: j.total)
            alike = [s for s in screened if s.effect.kind == first.fitted.effects[-1].kind]
            if first.structure > LARGE_RESIDUAL * found.base.structure:
                say(f"  {first.fitted.effects[-1]!r} leaves much: the same one at other places")
                wave = trying.families(alike, wave.best)
                everywhere.extend(j for j in wave.scored if lead_of(j, best).share >= FAMILY_SHARE)
                tried += everywhere
        yield tried
        if much:
            say("  none of these will do: others that promised less")
            wave = trying.singles(screened, further=True, best=wave.best)
            yield wave.scored
        groups = frictions(screened, best.fitted.effects)
        if groups and best.held_rms > NOISE_RMS and not have_stops(best.fitted.effects):
            say("  none of these will do: all frictions at one joint")
            yield trying.together(groups, wave.best).scored

    acceptance = Acceptance(comparison, judge, found.base, best, settings)
    everywhere: list[Judged] = []  # the same kind as the best single effect, at other locations too
    ranked: list[Judged] = []
    for tried in waves():
        ranked = acceptance.ranked([*ranked, *tried])
        for judged in ranked:
            if not any(judged is each for each in tried) or not acceptance.worth_naming(judged):
                continue
            if doubt := acceptance.doubt(judged):
                say(f"  {judged.fitted.effects[-1]!r}: {doubt}")
                continue
            accepted, dropped = acceptance.accept(judged)
            earlier = list(best.fitted.effects)
            new = len(accepted.fitted.effects) + len(dropped) - len(earlier)
            if any(judged is each for each in everywhere) and new < FAMILY_LOCATIONS:
                continue  # at one or two locations, adding them one at a time is better
            alone = trying.alone(judged, found.base.fitted) if earlier else None
            if alone is not None and not acceptance.believed(lead_of(accepted, alone)):
                acceptance = Acceptance(comparison, judge, found.base, found.base, settings)
                accepted, dropped = acceptance.accept(alone)[0], earlier
            return Step(rivals=ranked, accepted=accepted, dropped=dropped)
    return Step(rivals=ranked, accepted=None)
