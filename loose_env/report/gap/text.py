"""A comparison of model and measurement in plain words.

What the motions of a recording could show: effects unseen, and pairs that look alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from loose_env.gap import (
    ACCEPTED_Z,
    NOISE_RMS,
    EffectLocation,
    GapResult,
    Identifiability,
    NamedEffect,
    RankedHypothesis,
    how_to_see,
    how_to_separate,
    quantity_notes,
)
from loose_env.io import begun, duration_words
from loose_env.report.gap.effects import RIVALS, effect_words, kind_words, rivals_words
from loose_env.report.pages.sections import group

__all__ = [
    "headline",
    "mistaken_words",
    "next_steps",
    "ranked_words",
    "shown_group",
    "size_words",
    "summary_words",
    "unsure",
]

_HEADLINE = 36
"""Letters of the effects in the headline, at most."""


def headline(result: GapResult) -> str:
    """The outcome in one line.

    Examples
    --------
    >>> from loose_env.gap import Gap
    >>> headline(GapResult(verdict="no_gap", gap=Gap(before=1.0, after=1.0)))
    'No model error: the model explains the measurement.'
    """
    if result.verdict == "no_gap":
        return "No model error: the model explains the measurement."
    if result.verdict == "unexplained":  # nothing is named then
        likely = unsure(result)
        if likely is None:
            return "An effect is missing that is not in the catalogue."
        found = _first_short(likely.places)
        return f"An effect is missing, perhaps {found}."
    further = ", and a further effect" if _open(result) else ""
    return f"The model lacks {_first_short(result.effects)}{further}."


def summary_words(result: GapResult) -> list[str]:
    """Effects with their locations, and the residual before and after, below the headline."""
    found = []
    likely = unsure(result)
    if result.effects:
        found.append(f"{begun(_in_a_row(_grouped(result.effects)))}.")
    elif likely is not None:
        words = _in_a_row(_grouped(likely.places))
        found.append(f"It may be {words}; that is not significant in these runs.")
    after = "" if result.verdict == "no_gap" else f", {result.gap.after:.2f} after correction"
    found.append(
        f"Residual on held-out runs: {result.gap.before:.2f} noise standard deviations{after} "
        "(sensor noise alone: 1)."
    )
    return found


def _first_short(effects: Sequence[NamedEffect | EffectLocation]) -> str:
    """Effects in one line: with their locations, else without, else their number."""
    kinds = list(dict.fromkeys(kind_words(e.kind) for e in effects))
    choices = [_in_a_row(_grouped(effects)), _in_a_row(kinds)]
    fits = (words for words in choices if len(words) <= _HEADLINE)
    return next(fits, f"{len(effects)} effects")


def _open(result: GapResult) -> bool:
    """Whether a large residual remains after the identified effects."""
    return bool(result.remaining) and result.gap.after > NOISE_RMS and _by_impacts(result) is None


def _by_impacts(result: GapResult) -> NamedEffect | None:
    """A part with stops, identified by its impact power."""
    return next((e for e in result.effects if e.impact_power_explained is not None), None)


def unsure(result: GapResult) -> RankedHypothesis | None:
    """Insignificant hypothesis that explains an unexplained residual; None if there is none.

    Short runs have too few blocks of time for a significant improvement. That is no sign that the
    effect is missing from the catalogue.

    Examples
    --------
    >>> from loose_env.gap import Gap
    >>> friction = RankedHypothesis(
    ...     kind="coulomb_friction", where="joint2", held_out=1.01, bic=-9e3, improvement_z=1.7
    ... )
    >>> result = GapResult(
    ...     verdict="unexplained", gap=Gap(before=4.8, after=4.8), ranking=(friction,)
    ... )
    >>> headline(result)
    'An effect is missing, perhaps dry friction (joint2).'
    """
    if result.verdict != "unexplained" or result.gap.before <= NOISE_RMS:
        return None
    first = (r for r in result.ranking if r.step == 1 and r.improvement_z < ACCEPTED_Z)
    return next((r for r in first if r.held_out <= NOISE_RMS), None)


def _grouped(effects: Sequence[NamedEffect | EffectLocation]) -> list[str]:
    """Effects in words, those of one kind together."""
    places: dict[str, list[str]] = {}
    for effect in effects:
        places.setdefault(effect.kind, []).append(effect.where)
    return [effect_words(kind, ", ".join(where)) for kind, where in places.items()]


def _in_a_row(names: Sequence[str]) -> str:
    """Names as a sentence lists them."""
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def size_words(result: GapResult) -> list[str]:
    """Size of the model error, before and after correction."""
    gap = result.gap
    count = len(result.held_out_runs)
    runs = "one run" if count == 1 else f"{count} runs"
    said = (
        f"Residual of the nominal model on {runs} held out from all fits: {gap.before:.2f} noise "
        "standard deviations (sensor noise alone: 1)"
    )
    if result.verdict == "no_gap":
        return [f"{said}, explained by its tolerance and the noise."]
    left = f"; of the corrected model: {gap.after:.2f}."
    if gap.after <= NOISE_RMS:
        left += " The residual is down to the noise."
    elif (impact_fit := _by_impacts(result)) is not None:
        left += (
            " The times of impacts are not reproducible; of their power the corrected model "
            f"explains {100 * (impact_fit.impact_power_explained or 0.0):.0f} %."
        )
    elif gap.after < 0.7 * gap.before:
        left += " It is reduced, not eliminated: see the remaining residual."
    else:
        left += " Most of it remains."
    in_units = quantity_notes(gap.by_quantity)
    return [said + left, *(f"{words[0].upper()}{words[1:]}." for words in in_units)]


def mistaken_words(result: GapResult) -> list[str]:
    """Confusable effects of each identified one."""
    said = []
    alone = [e for e in result.effects if not e.ambiguous_with and e is not _by_impacts(result)]
    groups: dict[tuple[int, tuple[EffectLocation, ...]], list[NamedEffect]] = {}
    for effect in alone:
        groups.setdefault(_found_in(effect, result.ranking), []).append(effect)
    for (step, together), effects in groups.items():
        words = _in_a_row(_grouped(effects))
        others = sum(row.step == step and row.places != together for row in result.ranking)
        if not others:
            said.append(f"No other hypothesis was fitted to whole runs in place of {words}.")
            continue
        rivals = (
            "the one other hypothesis that was fitted to whole runs does not explain"
            if others == 1
            else f"none of the {others} other hypotheses that were fitted to whole runs explains"
        )
        said.append(f"In place of {words}, {rivals} the held-out runs as well.")
        if len(together) > 1:
            said.append(
                "These were fitted jointly; another effect at one of the locations, with the "
                "others unchanged, was not tried."
            )
    impact_fit = _by_impacts(result)
    if impact_fit is not None and not impact_fit.ambiguous_with:
        words = effect_words(impact_fit.kind, impact_fit.where)
        said.append(f"No play at another location explains the impact power as well as {words}.")
    for effect in result.effects:
        if not effect.ambiguous_with:
            continue
        words = effect_words(effect.kind, effect.where)
        named = " or from ".join(rivals_words(effect))
        said.append(f"The held-out runs do not separate {words} from {named}.")
    return said


def _found_in(
    effect: NamedEffect, ranking: Sequence[RankedHypothesis]
) -> tuple[int, tuple[EffectLocation, ...]]:
    """Step in which an effect was identified, and all that was fitted with it; 0 if unknown."""
    own = EffectLocation(kind=effect.kind, where=effect.where)
    for row in ranking:
        if own in row.places:
            return row.step, row.places
    return 0, ()


def ranked_words(row: RankedHypothesis) -> str:
    """Format a hypothesis for the table of candidate fits.

    Examples
    --------
    >>> several = (EffectLocation(kind="backlash", where="joint2"),)
    >>> ranked_words(
    ...     RankedHypothesis(
    ...         kind="backlash", where="joint1", held_out=1.0, bic=-9.0, together_with=several
    ...     )
    ... )
    'backlash at joint1, joint2'
    """
    places: dict[str, list[str]] = {}
    for place in row.places:
        places.setdefault(place.kind, []).append(place.where)
    return _in_a_row([f"{kind} at {', '.join(where)}" for kind, where in places.items()])


def next_steps(result: GapResult) -> list[str]:
    """Recommended next steps."""
    steps = []
    if result.verdict == "named":
        steps.append(
            "Simulate with model.xml. It is a plain MJCF file, and the recording's columns are "
            "valid in it."
        )
    if result.code:
        steps.append(
            "Apply the lines below to the simulation: MJCF has no means for them, so model.xml "
            "does not carry them."
        )
    for effect in result.effects:
        for other in effect.ambiguous_with[:RIVALS]:
            first, second = (
                effect_words(effect.kind, effect.where),
                effect_words(other.kind, other.where),
            )
            advice = how_to_separate(effect.kind, effect.where, other.kind, other.where)
            steps.append(f"To separate {first} from {second}: {advice[0].lower()}{advice[1:]}")
    likely = unsure(result)
    if likely is not None:
        words = _in_a_row(_grouped(likely.places))
        steps.append(
            f"Record more of these motions, or longer ones: {words} reduces the residual from "
            f"{result.gap.before:.2f} to {likely.held_out:.2f}, but with a z-score of only "
            f"{likely.improvement_z:.1f}."
        )
    if result.verdict == "unexplained":
        steps += [f"Look here: {words}" for words in result.location_words]
    elif _open(result):
        steps += [f"Look here for the missing effect: {words}" for words in result.remaining[1:]]
    if result.verdict == "unexplained" or _open(result):
        steps.append(
            "If you know the effect, add it: it is one small class in one file, and is fitted like "
            "those of the catalogue."
        )
    if result.verdict == "no_gap":
        steps.append(
            "To look closer, record motions that strain what you suspect: slow and fast, with "
            "reversals, over the whole range, with and without load."
        )
    trending = [t for t in result.residual_tests if t.trend_z >= 4 and abs(t.trend) > 0.5]
    if trending:
        steps.append(
            f"{_listed([t.channel for t in trending])} drift within a run: something warms up or "
            "creeps. Record a long run at constant motion."
        )
    return steps


def _listed(names: Sequence[str]) -> str:
    shown = list(names[:3]) + (["others"] if len(names) > 3 else [])
    return " and ".join([", ".join(shown[:-1]), shown[-1]] if len(shown) > 1 else shown)


_ROWS = 12
"""Lines of a table."""


def shown_group(found: Identifiability) -> dict[str, Any]:
    """Section on identifiability; empty where all effects are identifiable."""
    tables = []
    if found.unidentifiable:
        rows = [
            {
                "Effect": f"{each.kind} at {each.where}",
                "At a size of": ", ".join(f"{k} {v:.3g}" for k, v in each.parameters.items()),
                "z": f"{each.z:.1f}",
                "More of the same": _more(each.additional_s),
                "Better": how_to_see(each.kind),
            }
            for each in sorted(found.unidentifiable, key=lambda e: -e.z)[:_ROWS]
        ]
        tables.append(
            {"title": "Not identifiable", "rows": rows, "note": _rest(len(found.unidentifiable))}
        )
    if found.confusable:
        rows = [
            {
                "Effect": f"{pair.kind} at {pair.where}",
                "Confusable with": f"{pair.other_kind} at {pair.other_where}",
                "z": f"{pair.z:.1f}",
                "More of the same": _more(pair.additional_s),
                "Better": how_to_separate(pair.kind, pair.where, pair.other_kind, pair.other_where),
            }
            for pair in found.confusable[:_ROWS]
        ]
        tables.append({"title": "Confusable", "rows": rows, "note": _rest(len(found.confusable))})
    return group(
        "Identifiability from these motions",
        "Every effect at a size that matters, simulated on the training runs: its signature beyond "
        "the tolerance of the nominal parameters, as a z-score; 5 is needed.",
        tables=tables,
    )


def _more(seconds: float | None) -> str:
    return "no help" if seconds is None else duration_words(seconds)


def _rest(count: int) -> str:
    return f"{_ROWS} of {count}; all stand in result.json." if count > _ROWS else ""
