"""How often agents are right after so many records when they may not stop."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from loose_env.report.standings import Row, by_agent

__all__ = ["success_after"]


def success_after(rows: Sequence[Row]) -> dict[str, list[float]]:
    """Share of arms on which each agent's best hypothesis is right after record 1, 2, ...

    Parameters
    ----------
    rows : sequence of Row
        Episodes of agents that were made to take all records: every trail has the same length.

    Returns
    -------
    dict
        By agent. A trail cut short by a diverging simulation counts with its last entry, one
        without an entry as wrong.

    Examples
    --------
    >>> first = dict(agent="a", truth="x", trail_best=["y", "x"])
    >>> second = dict(agent="a", truth="x", trail_best=["x", "x"])
    >>> success_after([first, second])
    {'a': [0.5, 1.0]}
    """
    found = {}
    for agent, own in by_agent(rows).items() if rows else ():
        most = max(len(row.get("trail_best") or ()) for row in own)
        right = np.zeros((len(own), most))
        for hits, row in zip(right, own, strict=True):
            best = list(row.get("trail_best") or ())
            if best:
                best += [best[-1]] * (most - len(best))
                hits[:] = [name == row["truth"] for name in best]
        if most:
            found[agent] = [float(share) for share in right.mean(axis=0)]
    return found
