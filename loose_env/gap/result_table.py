"""What was found as a short table, as notebooks show it."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING

from loose_env.gap.quantities import quantity_words

if TYPE_CHECKING:
    from loose_env.gap.result import GapResult, NamedEffect

__all__ = ["html_table", "result_table"]

_VERDICTS = {
    "named": "The model lacks:",
    "no_gap": "No gap: within its tolerance the model explains the held-out runs.",
    "unexplained": "Unexplained: something is missing that is not in the catalogue.",
}
_HEADS = ("effect", "where", "parameter", "value", "95 %", "unit", "may as well be")


def html_table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Table of plain texts in HTML; "" if it has no rows.

    Examples
    --------
    >>> html_table(["a"], [["1 < 2"]])
    '<table><tr><th>a</th></tr><tr><td>1 &lt; 2</td></tr></table>'
    """
    if not rows:
        return ""
    lines = ["".join(f"<th>{escape(head)}</th>" for head in heads)]
    lines += ["".join(f"<td>{escape(cell)}</td>" for cell in row) for row in rows]
    return "<table>" + "".join(f"<tr>{line}</tr>" for line in lines) + "</table>"


def result_table(result: GapResult) -> str:
    """Verdict, effects and gap of a result in HTML."""
    rows = [row for effect in result.effects for row in _rows(effect)]
    gap = result.gap
    errors = [["all", f"{gap.before:.2f}", f"{gap.after:.2f}"]]
    errors += [
        [f"predictions over {seconds} s", f"{before:.2f}", f"{after:.2f}"]
        for seconds, (before, after) in gap.by_horizon_s.items()
    ]
    lives = "".join(f"<li>{escape(words)}</li>" for words in result.where_it_lives)
    unexplained = result.verdict == "unexplained" and lives
    return "".join(
        [
            f"<p><b>{escape(_VERDICTS[result.verdict])}</b></p>",
            html_table(_HEADS, rows),
            f"<ul>{lives}</ul>" if unexplained else "",
            html_table(["held-out runs, in noise standard deviations", "before", "after"], errors),
            *(f"<p>{escape(words)}</p>" for words in quantity_words(gap.by_quantity)),
            *(f"<p>Warning: {escape(words)}</p>" for words in result.warnings),
        ]
    )


def _rows(effect: NamedEffect) -> list[list[str]]:
    """One row for each parameter of an effect; the first says which effect it is."""
    others = ", ".join(f"{o.kind} at {o.where}" for o in effect.ambiguous_with)
    found: list[list[str]] = []
    for name, value in effect.parameters.items():
        ends = effect.interval_95.get(name)
        between = "" if ends is None else f"{ends[0]:.4g} to {ends[1]:.4g}"
        known = ["", ""] if found else [effect.kind, effect.where]
        unit, rivals = effect.units.get(name, ""), "" if found else others
        found.append([*known, name, f"{value:.4g}", between, unit, rivals])
    return found
