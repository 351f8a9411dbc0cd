"""A quick look in a few lines of text."""

from __future__ import annotations

from loose_env.gap import QuickCandidate, QuickLook
from loose_env.report.gap.effects import effect_words
from loose_env.report.pages.notebook import aligned

__all__ = ["quick_text"]

_HEAD = ("may be missing", "parameter", "value", "unit", "explains", "z", "residual left")


def quick_text(look: QuickLook) -> str:
    """Result of `loose gap --quick` in a few lines of text.

    Examples
    --------
    >>> print(quick_text(QuickLook(before=1.02)))
    Residual on held-out windows: 1.02 noise standard deviations; nothing hangs together in it.
    A quick look ranks and does not decide: run the command without --quick.
    """
    size = f"Residual on held-out windows: {look.before:.2f} noise standard deviations"
    lines = [f"{size}." if look.candidates else f"{size}; nothing hangs together in it."]
    lines += [f"  {words}" for words in look.location_words]
    if look.candidates:
        rows = [row for each in look.candidates for row in _rows(each)]
        lines += [f"  {line}" for line in aligned([_HEAD, *rows])]
    lines.append("A quick look ranks and does not decide: run the command without --quick.")
    return "\n".join(lines)


def _rows(candidate: QuickCandidate) -> list[tuple[str, ...]]:
    """One row for each parameter; names and figures of the whole in the first ones."""
    rows: list[tuple[str, ...]] = []
    figures = (
        f"{100 * candidate.explained:.0f} %",
        f"{candidate.held_out_z:.1f}",
        f"{candidate.held_out:.2f}",
    )
    for number, (effect, values, units) in enumerate(
        zip(candidate.effects, candidate.parameters, candidate.units, strict=True)
    ):
        name = f"{'and ' * (number > 0)}{effect_words(effect.kind, effect.where)}"
        for parameter, value in values.items():
            shown = figures if not rows else ("", "", "")
            rows.append(
                (name, parameter.replace("_", " "), f"{value:.4g}", units[parameter], *shown)
            )
            name = ""
    return rows
