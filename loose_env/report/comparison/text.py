"""All tables of a comparison, for a terminal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from loose_env.evaluation import (
    RATIO_EDGES,
    Row,
    by_agent,
    calibration_of,
    crossing,
    divisions,
    runs_of,
    standings,
    success_after,
    trained_agents,
)
from loose_env.report.comparison.terminal_tables import (
    calibration_table,
    crossed_table,
    curve_table,
    division_table,
    main_table,
    mistakes,
    trainings_table,
)


def comparison_text(
    rows: Sequence[Row],
    forced: Sequence[Row] = (),
    *,
    rng: np.random.Generator,
    reference: str | None = None,
    said: Sequence[str] = (),
) -> str:
    """Write the tables of a comparison, at most 120 columns wide.

    Parameters
    ----------
    rows : sequence of Row
        Episodes of all agents.
    forced : sequence of Row
        Episodes of agents that were made to take all records; calibration is computed on these
        where there are any, for then no record is missing because an agent was sure.
    rng : numpy.random.Generator
        Draws the bootstrap.
    reference : str, optional
        Agent whose return the others' is compared with.
    said : sequence of str
        Lines below the first table, such as a bound on records.
    """
    own = by_agent(rows)
    found = standings(rows, reference=reference, rng=rng)
    parts = [main_table(found, reference=reference), *said]
    crossed = crossing(found)
    if crossed is not None:
        parts.append(crossed_table(crossed))
    parts += [division_table(division) for division in divisions(rows)]
    curves = success_after(forced)
    if curves:
        parts.append(curve_table(curves))
    beliefs = by_agent(forced or rows)
    calibrated = [calibration_of(agent, some, edges=RATIO_EDGES) for agent, some in beliefs.items()]
    kept = [c for c in calibrated if c is not None]
    if kept:
        parts.append(calibration_table(kept))
    runs = {agent: len(names) for agent, names in trained_agents(own).items()}
    if runs:
        parts.append(trainings_table(runs_of(rows, rng=rng), runs))
    parts.append(mistakes(found[0].agent, own[found[0].agent]))
    diverged = Counter(str(row["truth"]).partition("@")[0] for row in rows if row["truncated"])
    if diverged:
        parts.append(f"Episodes ended by a diverging simulation: {dict(diverged)}")
    return "\n\n".join(part for part in parts if part)
