"""Words of the reports for shares, places and their verdicts, and effects of a model."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from loose_env.gap import EffectLocation, NamedEffect, effect_words
from loose_env.instrument import BOLTS, Diagnosis, Place
from loose_env.report.page import Table, named_list

LIGHTS: Mapping[str, tuple[str, str]] = {
    "loose": ("LOOSE", "#d55e00"),
    "suspect": ("suspect", "#e69f00"),
    "not tested": ("not tested", "#8a8f98"),
    "tight": ("tight", "#009e73"),
}
"""Verdict of a place -> its word and its colour, in the order of a table."""
RIVALS = 5  # confusable effects that are listed by name


def place_label(name: str) -> str:
    """Link's seat or joint's gear, as the rows of tables name it.

    Examples
    --------
    >>> place_label("backlash@elbow"), place_label("structural_looseness@wrist_1_link")
    ('joint elbow, gear', 'wrist_1_link, seat')
    """
    kind, _, at = name.partition("@")
    noun, part = ("link", "seat") if kind == BOLTS else ("joint", "gear")
    return f"{at}, {part}" if noun in at.lower() else f"{noun} {at}, {part}"


def place_table(d: Diagnosis) -> Table:
    """The traffic lights: a row for each link's seat and each joint's gear, worst first."""
    order, heard = list(LIGHTS), any(run.used for run in d.runs)
    rows = []
    for place in sorted(d.places, key=lambda p: (order.index(p.verdict), -p.probability)):
        suspected = place.verdict in ("loose", "suspect")
        rows.append(
            {
                "Place": _label(place),
                "Verdict": LIGHTS[place.verdict][0],
                "Probability": percent(place.probability) if suspected else "-",
                "Rhythm": f"{place.rhythm:.2f}" if heard else "-",
                "Tested": f"{100 * place.tested:.0f} %",
                "Reason": place.why.split(" (limit")[0] or "-",
            }
        )
    note = (
        "Probability: that it is the loose one, if one is. Rhythm: correlation of its foretold "
        "knocks with what the accelerometer heard. Tested: share of its directions in which the "
        "load reversed, so that it would have knocked. One that is not tested may be loose."
    )
    return Table(rows=rows, note=note)


def _label(place: Place) -> str:
    return f"{place.at}, on the ground" if place.base else place_label(place.name)


def light_colours(d: Diagnosis) -> dict[str, str]:
    """Colour beside the name of each place."""
    return {_label(p): LIGHTS[p.verdict][1] for p in d.places}


def percent(p: float) -> str:
    """A probability in per cent, never rounded to certainty.

    Examples
    --------
    >>> percent(0.9996), percent(0.9949), percent(0.42), percent(0.0002)
    ('over 99.9 %', '99.5 %', '42 %', 'under 0.1 %')
    """
    if p > 0.999:
        return "over 99.9 %"
    if p < 0.001:
        return "under 0.1 %"
    return f"{100 * p:.{1 if p > 0.99 or p < 0.01 else 0}f} %"


def path_word(path: str | Path) -> str:
    """A path as one word of a command line that is no option.

    Examples
    --------
    >>> path_word("runs/my session"), path_word("-old")
    ("'runs/my session'", './-old')
    """
    text = str(path)
    return shlex.quote(f"./{text}" if text.startswith("-") else text)


def together(effects: Iterable[EffectLocation]) -> str:
    """Effects in words, those of one kind together."""
    places: dict[str, list[str]] = {}
    for effect in effects:
        places.setdefault(effect.kind, []).append(effect.where)
    return named_list([effect_words(k, ", ".join(w)) for k, w in places.items()])


def rivals_words(effect: NamedEffect) -> list[str]:
    """Confusable effects of one, the first by name and the others by their number."""
    named = [
        ": ".join(
            filter(None, [effect_words(o.kind, o.where), o.values_in_words().replace("_", " ")])
        )
        for o in effect.ambiguous_with
    ]
    return first_ones(named)


def first_ones(words: Sequence[str]) -> list[str]:
    """The first of many, and how many more there are."""
    more = len(words) - RIVALS
    return [*words] if more < 2 else [*words[:RIVALS], f"{more} others, listed in result.json"]
