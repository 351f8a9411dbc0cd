"""What the motions of a recording could show: effects unseen, and pairs that look alike."""

from __future__ import annotations

from typing import Any

from loose_env.gap.diagnostics.experiment_advice import Identifiability, how_to_see, how_to_separate
from loose_env.io.text import duration_words
from loose_env.report.gap_parts import group

__all__ = ["shown_group"]

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
