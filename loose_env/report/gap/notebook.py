"""Model error as a notebook and a terminal show it: headline, missing effects, residual."""

from __future__ import annotations

from html import escape
from math import log1p

from loose_env.envs import palette as ink
from loose_env.gap import NOISE_RMS, GapResult, NamedEffect, quantity_notes
from loose_env.io import sentence
from loose_env.report.gap.effects import effect_words, rivals_words
from loose_env.report.gap.text import headline
from loose_env.report.pages.notebook import aligned, bar, bullets, cells_table

__all__ = ["gap_html", "gap_text"]

_EFFECTS = (
    "missing effect",
    "probability",
    "parameter",
    "value",
    "95 % interval",
    "unit",
    "confusable with",
)
_RESIDUAL = ("residual on held-out runs", "noise standard deviations")


def gap_text(result: GapResult, *, warnings: bool = True) -> str:
    """Result of `loose gap` in a few lines of text.

    Parameters
    ----------
    result : GapResult
        Result.
    warnings : bool
        True to end with the warnings.

    Examples
    --------
    >>> from loose_env.gap import Gap
    >>> print(gap_text(GapResult(verdict="no_gap", gap=Gap(before=1.04, after=1.04))))
    No model error: the model explains the measurement.
      residual on held-out runs  noise standard deviations
      nominal model              1.04
      corrected model            1.04
      sensor noise alone         1.00
    """
    lines = [headline(result), *(f"  {words}" for words in _where(result))]
    rows = [row for effect in result.effects for row in _rows(effect)]
    if rows:
        lines += [f"  {line}" for line in aligned([_EFFECTS, *rows])]
    residual = [(name, f"{value:.2f}") for name, value in _residual(result)]
    lines += [f"  {line}" for line in aligned([_RESIDUAL, *residual])]
    lines += [f"  {words}" for words in quantity_notes(result.gap.by_quantity)]
    lines += [f"remaining: {words}" for words in _remaining(result)]
    if warnings:
        lines += [f"{severity}: {sentence(words)}" for severity, words in result.graded_warnings]
    return "\n".join(lines)


def gap_html(result: GapResult) -> str:
    """Result of `loose gap` as a fragment of HTML, with the residuals drawn as bars."""
    rows = [row for effect in result.effects for row in _rows(effect)]
    largest = max(NOISE_RMS, *(value for _, value in _residual(result)))
    residual = [
        (name, bar(log1p(value) / log1p(largest), colour=colour), f"{value:.2f}")
        for (name, value), colour in zip(
            _residual(result), (ink.TRUTH, ink.MEASURED, ink.MUTED), strict=True
        )
    ]
    return "".join(
        [
            f"<p><strong>{escape(headline(result))}</strong></p>",
            cells_table(_EFFECTS, rows),
            cells_table((_RESIDUAL[0], "logarithmic", _RESIDUAL[1]), residual, markup=(1,)),
            bullets("Location of the residual", _where(result)),
            bullets("In physical units", quantity_notes(result.gap.by_quantity)),
            bullets("Remaining", _remaining(result)),
            bullets("Warnings", [sentence(words) for _, words in result.graded_warnings]),
        ]
    )


def _where(result: GapResult) -> tuple[str, ...]:
    """Location of a residual that nothing explains."""
    return result.location_words if result.verdict == "unexplained" else ()


def _remaining(result: GapResult) -> tuple[str, ...]:
    """Residual that the identified effects leave; without one the location says it."""
    return result.remaining if result.verdict == "named" else ()


def _residual(result: GapResult) -> list[tuple[str, float]]:
    """Residual of nominal and corrected model, beside that of sensor noise alone."""
    gap = result.gap
    return [
        ("nominal model", gap.before),
        ("corrected model", gap.after),
        ("sensor noise alone", gap.noise_floor),
    ]


def _rows(effect: NamedEffect) -> list[tuple[str, ...]]:
    """Rows of an effect's parameters; the first names the effect."""
    likely = "" if effect.probability is None else f"{100 * effect.probability:.0f} %"
    others = ", ".join(rivals_words(effect))
    found: list[tuple[str, ...]] = []
    for name, value in effect.parameters.items():
        ends = effect.interval_95.get(name)
        between = "" if ends is None else f"{ends[0]:.4g} to {ends[1]:.4g}"
        first = not found
        found.append(
            (
                effect_words(effect.kind, effect.where) if first else "",
                likely if first else "",
                name.replace("_", " "),
                f"{value:.4g}",
                between,
                effect.units.get(name, ""),
                others if first else "",
            )
        )
    return found
