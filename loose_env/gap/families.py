"""Several effects at once, where one by one each explains little.

One kind at several places, for servos, gears and bearings of an arm are alike; or all that slows
one joint down, for oil, seals and air do so together.
"""

from __future__ import annotations

from collections.abc import Sequence

from loose_env.gap.effect import Effect
from loose_env.gap.screening import Screened

__all__ = ["families", "frictions"]

_ALL = "all"
_LEAST = 0.02
"""Promise of a member, as a share of the most promising one of its family."""
_FRICTIONS = ("viscous_friction", "coulomb_friction", "quadratic_drag")
"""What grows with no power of the speed, the first and the second. One of them, fitted to all
three, leaves a little that neither of the others is any good for alone."""


def families(screened: Sequence[Screened], most: int) -> list[list[Screened]]:
    """Groups of candidates of one kind and variant at two places or more.

    A drive that is set otherwise than its model is seldom the only one. Taken one by one, each
    explains little as long as the others are missing, and something else that explains a little
    of all of them comes first. A candidate at "all" places is such a group already, and no member.

    Parameters
    ----------
    screened : sequence of Screened
        Candidates, the most promising first.
    most : int
        Most groups.

    Returns
    -------
    list of list of Screened
        Groups whose members promise most together, of every kind the best variant.
    """
    groups: dict[tuple[str, str], list[Screened]] = {}
    for each in screened:
        if each.effect.where == _ALL:
            continue
        groups.setdefault((each.effect.kind, each.effect.variant), []).append(each)
    best: dict[str, tuple[float, list[Screened]]] = {}
    for (kind, _), group in groups.items():
        least = _LEAST * group[0].promise
        members = [each for each in group if each.promise >= least]
        promise = sum(each.promise for each in members)
        if len(members) > 1 and promise > best.get(kind, (0.0, []))[0]:
            best[kind] = promise, members
    ranked = sorted(best.values(), key=lambda found: -found[0])
    return [members for _, members in ranked[:most]]


def frictions(screened: Sequence[Screened], named: Sequence[Effect]) -> list[list[Screened]]:
    """Groups of the frictions that are missing at joints at which one was named.

    Parameters
    ----------
    screened : sequence of Screened
        Candidates.
    named : sequence of Effect
        What was named.

    Returns
    -------
    list of list of Screened
        One group of two for each such joint, where both are candidates.
    """
    joints = dict.fromkeys(effect.where for effect in named if effect.kind in _FRICTIONS)
    groups = [
        [s for s in screened if s.effect.where == joint and s.effect.kind in _FRICTIONS]
        for joint in joints
    ]
    return [group for group in groups if len(group) > 1]
