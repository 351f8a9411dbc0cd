"""A comparison of model and measurement in plain words.

What the motions of a recording could show: effects unseen, and pairs that look alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from loose_env.gap import (
    ACCEPTED_Z,
    NOISE_RMS,
    GapResult,
    Identifiability,
    NamedEffect,
    Place,
    Ranked,
    how_to_see,
    how_to_separate,
    quantity_words,
)
from loose_env.io import duration_words
from loose_env.report.pages.sections import group

__all__ = [
    "effect_words",
    "headline",
    "mistaken_words",
    "next_steps",
    "ranked_words",
    "shown_group",
    "size_words",
    "sure_words",
    "unsure",
]

_PLAIN = {
    "viscous_friction": "viscous friction",
    "coulomb_friction": "dry friction",
    "stribeck_friction": "dry friction that grows near rest",
    "quadratic_drag": "drag that grows with the square of the speed",
    "joint_compliance": "a compliant drive",
    "backlash": "backlash",
    "structural_looseness": "a loose link",
    "link_flexibility": "a flexible link",
    "link_mass": "another mass",
    "link_com": "another centre of mass",
    "payload": "a payload",
    "rotor_inertia": "more rotor inertia",
    "actuator_gain": "another gain",
    "actuator_lag": "a lag",
    "command_delay": "late commands",
    "encoder_offset": "an encoder whose zero is off",
    "sensor_misalignment": "a sensor that is mounted askew",
    "sensor_gain": "a sensor whose scale is off",
    "sensor_bias": "a sensor with a bias",
    "sensor_delay": "a late sensor",
    "base_tilt": "a tilted base",
    "torque_ripple": "torque ripple",
    "joint_spring": "a spring",
}
_PLACES = {
    ("payload", "tool"): "at the tool",
    ("base_tilt", "base"): "",
    ("command_delay", "all"): "at all actuators",
}
"""Places that are no names of the model; a joint or a link may be called so, too."""


def effect_words(kind: str, where: str) -> str:
    """An effect and its place, as one says it.

    Examples
    --------
    >>> effect_words("coulomb_friction", "joint2")
    'dry friction (joint2)'
    """
    words = _PLAIN.get(kind, kind.replace("_", " "))
    place = _PLACES.get((kind, where))
    return f"{words} ({where})" if place is None else f"{words} {place}".rstrip()


def headline(result: GapResult) -> str:
    """The outcome in one sentence."""
    if result.verdict == "no_gap":
        return "Nothing is missing: the model explains what was measured."
    if result.verdict == "unexplained":  # nothing is named then
        likely = unsure(result)
        if likely is None:
            return "Something is missing that is not in the catalogue."
        words = _in_a_row(_grouped(likely.places))
        return f"Something is missing. It may be {words}, but these runs do not make that sure."
    listed = _in_a_row(_grouped(result.effects))
    return f"The model lacks {listed}{', and something else' if _open(result) else ''}."


def _open(result: GapResult) -> bool:
    """Whether much is left of the gap after what was named."""
    return bool(result.left) and result.gap.after > NOISE_RMS and _by_blows(result) is None


def _by_blows(result: GapResult) -> NamedEffect | None:
    """A part that was found by how hard it strikes its stops."""
    return next((e for e in result.effects if e.powers_explained is not None), None)


def unsure(result: GapResult) -> Ranked | None:
    """What would close a gap in which nothing could be named; None if nothing would.

    Short runs have too few stretches of time for any lead to be sure. That is no sign that the
    effect is missing from the catalogue.

    Examples
    --------
    >>> from loose_env.gap import Gap
    >>> friction = Ranked(
    ...     kind="coulomb_friction", where="joint2", held_out=1.01, bic=-9e3, lead=1.7
    ... )
    >>> result = GapResult(
    ...     verdict="unexplained", gap=Gap(before=4.8, after=4.8), ranking=(friction,)
    ... )
    >>> headline(result)
    'Something is missing. It may be dry friction (joint2), but these runs do not make that sure.'
    """
    if result.verdict != "unexplained" or result.gap.before <= NOISE_RMS:
        return None
    first = (r for r in result.ranking if r.step == 1 and r.lead < ACCEPTED_Z)
    return next((r for r in first if r.held_out <= NOISE_RMS), None)


def _grouped(effects: Sequence[NamedEffect | Place]) -> list[str]:
    """Effects in words, those of one kind together."""
    places: dict[str, list[str]] = {}
    for effect in effects:
        places.setdefault(effect.kind, []).append(effect.where)
    return [effect_words(kind, ", ".join(where)) for kind, where in places.items()]


def _in_a_row(names: Sequence[str]) -> str:
    """Names as a sentence lists them."""
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def size_words(result: GapResult) -> list[str]:
    """How large the gap is and what is left of it."""
    gap = result.gap
    count = len(result.held_out_runs)
    runs = "one run" if count == 1 else f"{count} runs"
    said = (
        f"On {runs} that no fit has seen, the nominal model is {gap.before:.2f} times as far from "
        "the measurement as the noise of the sensors alone would put it"
    )
    if result.verdict == "no_gap":
        return [f"{said}: that is what its tolerance and the noise leave."]
    left = f"; the corrected model {gap.after:.2f} times."
    if gap.after <= NOISE_RMS:
        left += " The gap is closed down to the noise."
    elif (struck := _by_blows(result)) is not None:
        left += (
            " Blows fall at moments that no simulation repeats; of how hard and how often they "
            f"do, the corrected model explains {100 * (struck.powers_explained or 0.0):.0f} %."
        )
    elif gap.after < 0.7 * gap.before:
        left += " The gap is smaller, not closed: see what is left."
    else:
        left += " Most of the gap is still there."
    in_units = quantity_words(gap.by_quantity)
    return [said + left, *(f"{words[0].upper()}{words[1:]}." for words in in_units)]


def sure_words(effect: NamedEffect) -> str:
    """Values of an effect's parameters and how sure they are."""
    parts = []
    for name, value in effect.parameters.items():
        unit = effect.units.get(name, "")
        ends = effect.interval_95.get(name)
        between = "" if ends is None else f", 95 % between {ends[0]:.3g} and {ends[1]:.3g}"
        parts.append(f"{name.replace('_', ' ')} {value:.3g} {unit}".rstrip() + between)
    return "; ".join(parts)


def mistaken_words(result: GapResult) -> list[str]:
    """What each effect could be mistaken for."""
    said = []
    alone = [e for e in result.effects if not e.ambiguous_with and e is not _by_blows(result)]
    groups: dict[tuple[int, tuple[Place, ...]], list[NamedEffect]] = {}
    for effect in alone:
        groups.setdefault(_found_in(effect, result.ranking), []).append(effect)
    for (step, together), effects in groups.items():
        words = _in_a_row(_grouped(effects))
        others = sum(row.step == step and row.places != together for row in result.ranking)
        if not others:
            said.append(f"Nothing else was fitted to whole runs in place of {words}.")
            continue
        rivals = (
            "the one other hypothesis that was fitted to whole runs does not explain"
            if others == 1
            else f"none of the {others} other hypotheses that were fitted to whole runs explains"
        )
        said.append(f"In place of {words}, {rivals} the held-out runs as well.")
        if len(together) > 1:
            said.append(
                "These were fitted together; something else at one of the places, with the others "
                "as they are, was not tried."
            )
    struck = _by_blows(result)
    if struck is not None and not struck.ambiguous_with:
        words = effect_words(struck.kind, struck.where)
        said.append(f"No play anywhere else strikes as this does: {words}.")
    for effect in result.effects:
        if not effect.ambiguous_with:
            continue
        words = effect_words(effect.kind, effect.where)
        others_named = [effect_words(o.kind, o.where) for o in effect.ambiguous_with]
        said.append(
            f"The held-out runs cannot tell {words} from {' or from '.join(others_named)}: it may "
            "be either."
        )
    return said


def _found_in(effect: NamedEffect, ranking: Sequence[Ranked]) -> tuple[int, tuple[Place, ...]]:
    """Step in which an effect was found, and all that was found with it; 0 where not known."""
    own = Place(kind=effect.kind, where=effect.where)
    for row in ranking:
        if own in row.places:
            return row.step, row.places
    return 0, ()


def ranked_words(row: Ranked) -> str:
    """A hypothesis as the table of what was tried lists it.

    Examples
    --------
    >>> several = (Place(kind="backlash", where="joint2"),)
    >>> ranked_words(
    ...     Ranked(kind="backlash", where="joint1", held_out=1.0, bic=-9.0, together_with=several)
    ... )
    'backlash at joint1, joint2'
    """
    places: dict[str, list[str]] = {}
    for place in row.places:
        places.setdefault(place.kind, []).append(place.where)
    return _in_a_row([f"{kind} at {', '.join(where)}" for kind, where in places.items()])


def next_steps(result: GapResult) -> list[str]:
    """What to do now."""
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
        for other in effect.ambiguous_with:
            first, second = (
                effect_words(effect.kind, effect.where),
                effect_words(other.kind, other.where),
            )
            advice = how_to_separate(effect.kind, effect.where, other.kind, other.where)
            steps.append(f"To tell {first} from {second}: {advice[0].lower()}{advice[1:]}")
    likely = unsure(result)
    if likely is not None:
        words = _in_a_row(_grouped(likely.places))
        steps.append(
            f"Record more of these motions, or longer ones: with {words} the model leaves "
            f"{likely.held_out:.2f} of {result.gap.before:.2f}, but is ahead by {likely.lead:.1f} "
            "standard deviations only."
        )
    if result.verdict == "unexplained":
        steps += [f"Look here: {words}" for words in result.where_it_lives]
    elif _open(result):
        steps += [f"Look here for what else is missing: {words}" for words in result.left[1:]]
    if result.verdict == "unexplained" or _open(result):
        steps.append(
            "If you know what it is, add it: an effect is one small class in one file, and is "
            "tried like the others."
        )
    if result.verdict == "no_gap":
        steps.append(
            "To look closer, record motions that strain what you suspect: slow and fast, with "
            "reversals, over the whole range, with and without load."
        )
    trending = [t for t in result.left_over if t.trend_sureness >= 4 and abs(t.trend) > 0.5]
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
    """Section on what cannot be seen or told apart; nothing where all can."""
    tables = []
    if found.unseen:
        rows = [
            {
                "Effect": f"{each.kind} at {each.where}",
                "At a size of": ", ".join(f"{k} {v:.3g}" for k, v in each.parameters.items()),
                "Seen by": f"{each.sureness:.1f}",
                "More of the same": _more(each.more_s),
                "Better": how_to_see(each.kind),
            }
            for each in sorted(found.unseen, key=lambda e: -e.sureness)[:_ROWS]
        ]
        tables.append({"title": "Not seen", "rows": rows, "note": _rest(len(found.unseen))})
    if found.alike:
        rows = [
            {
                "Effect": f"{pair.kind} at {pair.where}",
                "Looks like": f"{pair.other_kind} at {pair.other_where}",
                "Told apart by": f"{pair.sureness:.1f}",
                "More of the same": _more(pair.more_s),
                "Better": how_to_separate(pair.kind, pair.where, pair.other_kind, pair.other_where),
            }
            for pair in found.alike[:_ROWS]
        ]
        tables.append({"title": "Alike", "rows": rows, "note": _rest(len(found.alike))})
    return group(
        "What these motions can show",
        "Every effect at a size that matters, simulated on the runs fitted to: what it changes "
        "beyond the tolerance of the nominal figures, in standard deviations; five are needed.",
        tables=tables,
    )


def _more(seconds: float | None) -> str:
    return "no help" if seconds is None else duration_words(seconds)


def _rest(count: int) -> str:
    return f"{_ROWS} of {count}; all stand in result.json." if count > _ROWS else ""
