"""Hold-out split of runs into training and held-out, by families of motions, never by rows."""

from __future__ import annotations

import re
from collections.abc import Sequence

from loose_env.errors import InvalidData

_LARGEST = 0.5
"""Share of all runs above which what shares a first word is no family of motions."""


def split_runs(
    names: Sequence[str], *, share: float = 0.25, held_out: Sequence[str] = ()
) -> tuple[list[int], list[int]]:
    """Split runs into training and held-out runs, by families of motions.

    Families are held out whole: ``single_joint_elbow`` is nearly redundant with
    ``single_joint_wrist`` for scoring. Runs whose names begin with the same word are a family,
    unless only numbers follow it, or most runs would be in it. Families are held out evenly through
    the recording, at least one, the last among them; whatever the share, one remains for training.

    Examples
    --------
    >>> split_runs(["run-1.csv", "run-2.csv", "run-3.csv", "run-4.csv"])
    ([0, 1, 2], [3])
    >>> split_runs(
    ...     [
    ...         "step.csv",
    ...         "swing_slow.csv",
    ...         "swing_fast.csv",
    ...         "circle.csv",
    ...         "hold.csv",
    ...         "ramp_up.csv",
    ...         "ramp_down.csv",
    ...     ]
    ... )
    ([0, 1, 2, 3, 4], [5, 6])
    >>> split_runs(["step.csv", "swing_slow.csv", "swing_fast.csv"], held_out=["swing"])
    ([0], [1, 2])
    """
    count = len(names)
    if count < 2:
        raise InvalidData(
            f"the recording has {count} run; at least two are needed, so that one can be held "
            "out to judge by. Record another run with another motion"
        )
    if held_out:
        chosen = _chosen(names, held_out)
    else:
        families = _families(names)
        number = min(max(1, round(share * len(families))), len(families) - 1)
        last = len(families) - 1
        taken = {last - round(k * len(families) / number) for k in range(number)}
        chosen = {k for f in taken for k in families[f]}
    return [k for k in range(count) if k not in chosen], sorted(chosen)


def _chosen(names: Sequence[str], held_out: Sequence[str]) -> set[int]:
    """Indices of the runs that a user holds out."""
    found: set[int] = set()
    for given in held_out:
        own = {k for k, name in enumerate(names) if name == given or name.startswith(given)}
        if not given or not own:
            raise InvalidData(
                f"no run to hold out is called {given!r} or begins so; there are {', '.join(names)}"
            )
        found |= own
    if len(found) == len(names):
        raise InvalidData("all runs are held out, and none is left to fit to; hold out fewer")
    return found


def _families(names: Sequence[str]) -> list[list[int]]:
    """Indices of the runs of each family, in the order of their first ones."""
    found: dict[str, list[int]] = {}
    for k, name in enumerate(names):
        stem = name.rsplit("/", 1)[-1].rsplit(".", 1)[0]
        first, *others = [word for word in re.split(r"[\W_]+|(?<=\D)(?=\d)", stem) if word] or [""]
        numbered = all(word.isdigit() for word in others)
        found.setdefault(f"{k}" if numbered and others else first, []).append(k)
    large = [family for family, own in found.items() if len(own) > _LARGEST * len(names)]
    if large or len(found) < 2:
        return [[k] for k in range(len(names))]
    return list(found.values())
