"""Words of the reports for joints, links, hypotheses, shares and effects of a model."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from loose_env.arms import Arm
from loose_env.errors import InvalidData
from loose_env.gap import EffectLocation, NamedEffect, effect_words
from loose_env.instrument import HEALTHY
from loose_env.report.page import named_list

RIVALS = 5  # confusable effects that are listed by name


def joint_words(arm: Arm, joint: str) -> str:
    """Name a joint, with its number from the base where the name does not have it."""
    return _named("joint", arm.joints, joint, arm)


def link_words(arm: Arm, body: str) -> str:
    """Name a link, with its number from the base where the name does not have it."""
    return _named("link", arm.seat_bodies, body, arm)


def _named(noun: str, names: tuple[str, ...], name: str, arm: Arm) -> str:
    if name not in names:
        raise InvalidData(
            f"the diagnosis names {name!r}, which is no {noun} of arm {arm.name!r}; it has "
            f"{', '.join(names)}: give the model that was diagnosed"
        )
    number = names.index(name) + 1
    same = name.lower().replace("_", " ") in (f"{noun} {number}", f"{noun}{number}")
    return f"{noun} {number}" if same else f"{noun} {number} ({name})"


def short_name(arm: Arm, hypothesis: str) -> str:
    """Say a hypothesis in a few words.

    Examples
    --------
    >>> from loose_env.arms import DESK_ARM, arm_from_file, planar
    >>> short_name(planar(2), "structural_looseness@link1"), short_name(planar(2), "healthy")
    ('link 1 is loose', 'nothing is loose')
    >>> short_name(arm_from_file(DESK_ARM), "backlash@elbow")
    'joint 3 (elbow) has play'
    """
    kind, _, where = hypothesis.partition("@")
    if kind == HEALTHY:
        return "nothing is loose"
    if kind == "backlash":
        return f"{joint_words(arm, where)} has play"
    return f"{link_words(arm, where)} is loose"


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


def slides(arm: Arm, joint: str) -> bool:
    """True for a prismatic joint of the arm."""
    return joint in arm.joints and bool(arm.sliding[arm.joints.index(joint)])


def position_text(arm: Arm, joint: str, value: float) -> str:
    """Position of a joint in the unit that a teach panel shows.

    Examples
    --------
    >>> from loose_env.arms import scara
    >>> position_text(scara(), "joint1", 0.5), position_text(scara(), "joint3", -0.05)
    ('28.6°', '−50.0 mm')
    """
    shown = f"{1e3 * value:.1f} mm" if slides(arm, joint) else f"{np.degrees(value):.1f}°"
    return shown.replace("-0.0", "0.0").replace("-", "−")


def with_plain_names(words: str, names: Mapping[str, str]) -> str:
    """Text with the hypotheses, but for "healthy", in plain words.

    Examples
    --------
    >>> with_plain_names("backlash@j1 is left", {"backlash@j1": "joint 1 has play"})
    '“joint 1 has play” is left'
    """
    for name in sorted(names, key=len, reverse=True):  # one name may begin another
        if "@" in name:
            words = words.replace(name, f"“{names[name]}”")
    return words


def together(effects: Iterable[EffectLocation]) -> str:
    """Effects in words, those of one kind together."""
    places: dict[str, list[str]] = {}
    for effect in effects:
        places.setdefault(effect.kind, []).append(effect.where)
    return named_list([effect_words(k, ", ".join(w)) for k, w in places.items()])


def rivals_words(effect: NamedEffect) -> list[str]:
    """Confusable effects of one, the first by name and the others by their number."""
    named = [effect_words(o.kind, o.where) for o in effect.ambiguous_with]
    more = len(named) - RIVALS
    return named if more < 2 else [*named[:RIVALS], f"{more} others, listed in result.json"]
