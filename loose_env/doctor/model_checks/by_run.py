"""Grouping of runs for a check: all together, or each alone where they contradict each other."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from typing import TypeVar

Part = TypeVar("Part")


def judged_runs(
    parts: Mapping[str, Part], verdict: Callable[[str, Part], Hashable | None]
) -> list[tuple[str, list[Part]]]:
    """Parts of all runs together where the runs agree; else each run that tells something.

    All runs together scatter less; but a recorder that was set up anew between two runs leaves
    one of them in another unit, which a mean over all hides.

    Examples
    --------
    >>> judged_runs({"a": 1.0, "b": 1.1}, lambda _, ratio: ratio > 50)
    [('', [1.0, 1.1])]
    >>> judged_runs({"a": 1.0, "b": 57.3}, lambda _, ratio: ratio > 50)
    [('a', [1.0]), ('b', [57.3])]
    """
    told = {name: said for name, part in parts.items() if (said := verdict(name, part)) is not None}
    if len(set(told.values())) > 1:
        return [(name, [parts[name]]) for name in told]
    return [("", list(parts.values()))] if parts else []
