"""One kind of effect at several places at once: servos, gears and bearings of an arm are alike."""

from __future__ import annotations

from collections.abc import Sequence

from loose_env.gap.screening import Screened

__all__ = ["families"]

_ALL = "all"
_LEAST = 0.02
"""Promise of a member, as a share of the most promising one of its family."""


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
