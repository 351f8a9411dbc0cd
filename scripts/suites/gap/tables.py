"""What a suite prints: the table of targets and the confusion matrix, as text and as markdown."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from scripts.suites.gap.cases import ROLES
from scripts.suites.gap.effects import CATALOGUE, OUTSIDE
from scripts.suites.gap.grading import FAILED, NAMED, NO_GAP, UNEXPLAINED, Grade

SEVERAL = "several"
"""Column of the confusion matrix for results that name more than one effect."""
PLACE = "elsewhere"
"""Column for the right kind at a wrong place."""
SIGNS = {
    NO_GAP: ("0", "nothing missing"),
    UNEXPLAINED: ("?", "unexplained"),
    SEVERAL: ("+", "more than one effect"),
    PLACE: ("@", "the right kind elsewhere"),
    FAILED: ("!", "failed"),
}
"""Headings of narrow columns, and what they stand for."""
ON_READING = frozenset({"sensor_gain", "sensor_bias", "torque_ripple"})
"""Kinds that a model file cannot carry; the result has code for them."""
CLOSE = 0.1
"""Relative error up to which a parameter counts as close."""


def share(hits: int, count: int) -> str:
    """A share in per cent with Wilson's 95 % interval."""
    if count == 0:
        return "no cases"
    z = 1.96
    p = hits / count
    middle = (p + z * z / (2 * count)) / (1 + z * z / count)
    half = z * math.sqrt(p * (1 - p) / count + z * z / (4 * count * count)) / (1 + z * z / count)
    low, high = max(0.0, middle - half), min(1.0, middle + half)
    return f"{hits}/{count} = {100 * p:.0f} % ({100 * low:.0f} to {100 * high:.0f})"


def summary(grades: Sequence[Grade]) -> list[tuple[str, str, str]]:
    """Rows of the table of targets: what, target, measured."""
    by = {role: [g for g in grades if g.role == role] for role in ROLES}
    outside, several = by["outside"], by["single"] + by["pair"] + by["triple"]
    missing = by["single"] + by["pair"] + by["triple"] + by["machine"]
    whole = [g for g in several if g.found == len(g.truth) > 0]
    machines = by["machine"]
    after = [
        g.gap_after
        for g in missing
        if np.isfinite(g.gap_after) and not any(kind in ON_READING for kind, _ in g.truth)
    ]
    before = [g.gap_before for g in missing if np.isfinite(g.gap_before)]
    errors = [error for g in missing for error in g.parameter_error]
    covered = [held for g in missing for held in g.covered]
    others = [held for g in missing for held in g.covered_others]
    exported = [g.exported for g in grades if np.isfinite(g.exported)]
    found = sum(g.found for g in by["pair"])
    seconds = [g.seconds for g in grades if np.isfinite(g.seconds)]
    rows = [
        ("single effects, kind and location correct", "at least 97 %", _right(by["single"])),
        ("pairs, both correct", "at least 88 %", _right(by["pair"])),
        ("effects of pairs found", "at least 95 %", share(found, 2 * len(by["pair"]))),
        ("triples, all three correct", "at least 70 %", _right(by["triple"])),
        ("effects of triples found", "at least 90 %", _found(by["triple"])),
        ("effects of whole machines found", "at least 85 %", _found(machines)),
        ("effects identified in whole machines that are there", "at least 95 %",
         share(sum(g.found for g in machines), sum(len(g.said) for g in machines))),
        ("a further, false effect beside the true ones", "at most 3 %",
         share(sum(len(g.said) > len(g.truth) for g in whole), len(whole))),
        ("false alarms with nothing missing", "at most 2 %",
         share(sum(not g.right for g in by["none"]), len(by["none"]))),
        ("outside the catalogue, called unexplained", "at least 90 %", _right(outside)),
        ("held-out RMS residual before, median [noise sd]", "", _median(before)),
        ("held-out RMS residual after, representable effects, median [noise sd]", "at most 1.25",
         _median(after)),
        ("error of parameters, median", "at most 10 %",
         f"{100 * np.median(errors):.1f} %" if errors else "none"),
        ("parameters within 10 % of the truth", "",
         share(sum(error <= CLOSE for error in errors), len(errors))),
        ("95 % intervals that cover the true value", "92 to 97 %",
         share(sum(covered), len(covered))),
        ("the same of further parameters", "92 to 97 %", share(sum(others), len(others))),
        ("residual of the exported model in plain MuJoCo over the fit's, median and largest", "",
         f"{np.median(exported):.3f}, {max(exported):.3f} ({len(exported)} cases)"
         if exported else "none"),
        ("time of one run on one core, median and largest [s]", "",
         f"{np.median(seconds):.0f}, {max(seconds):.0f}" if seconds else "none"),
        ("cases that failed, wrong in all of the above", "0",
         share(sum(g.verdict == FAILED for g in grades), len(grades))),
    ]  # fmt: skip
    return rows


def _right(grades: Sequence[Grade]) -> str:
    return share(sum(g.right for g in grades), len(grades))


def _found(grades: Sequence[Grade]) -> str:
    return share(sum(g.found for g in grades), sum(len(g.truth) for g in grades))


def _median(values: Sequence[float]) -> str:
    return f"{np.median(values):.2f}" if values else "none"


def confusion(grades: Sequence[Grade]) -> tuple[list[str], list[str], np.ndarray]:
    """Confusion matrix over cases with at most one effect."""
    rows = [*CATALOGUE, NO_GAP, *OUTSIDE]
    columns = [*CATALOGUE, NO_GAP, UNEXPLAINED, SEVERAL, PLACE, FAILED]
    counts = np.zeros((len(rows), len(columns)), dtype=np.int64)
    for g in grades:
        if g.role in ("pair", "triple", "machine") or (g.role != "none" and not g.truth):
            continue  # two rows, or, of a case that could not be drawn, none
        row = rows.index(g.truth[0][0]) if g.truth else rows.index(NO_GAP)
        counts[row, columns.index(_said(g))] += 1
    return rows, columns, counts


def _said(g: Grade) -> str:
    if g.verdict in (NO_GAP, UNEXPLAINED, FAILED):
        return g.verdict
    if len(g.said) != 1:
        return SEVERAL
    kind = g.said[0][0]
    if g.truth and kind == g.truth[0][0] and g.said[0] != g.truth[0] and not g.right:
        return PLACE
    return kind if kind in CATALOGUE else SEVERAL


def markdown(grades: Sequence[Grade]) -> str:
    """The table of targets, the confusion matrix and the marks by size, as markdown."""
    parts = ["| | to reach | measured |", "| --- | --- | --- |"]
    parts += [
        f"| {what} | {_whole(target)} | {_whole(got)} |" for what, target, got in summary(grades)
    ]
    rows, columns, counts = confusion(grades)
    used = [c for c in range(len(columns)) if counts[:, c].any()]
    legend = ["kinds by the numbers of their rows"]
    legend += [" ".join(SIGNS[columns[c]]) for c in used if columns[c] in SIGNS]
    parts += ["", f"True effect (rows) and result (columns: {'; '.join(legend)}):"]
    parts += ["", "| | " + " | ".join(_short(columns, c) for c in used) + " |"]
    parts += ["| --- |" + " ---: |" * len(used)]
    for r, row in enumerate(rows):
        if counts[r].any():
            cells = [_marked(counts[r, c], right=columns[c] == _expected(row)) for c in used]
            number = _short(columns, columns.index(_expected(row)))
            parts.append(f"| {number}\N{NO-BREAK SPACE}{row} | " + " | ".join(cells) + " |")
    parts += ["", "| size over just visible | single effects correct |", "| --- | --- |"]
    singles = [g for g in grades if g.role == "single"]
    for low, high in ((0.0, 2.0), (2.0, 5.0), (5.0, 12.0), (12.0, np.inf)):
        within = [g for g in singles if low <= g.ratio < high]
        label = f"{low:.0f} to {high:.0f}" if np.isfinite(high) else f"over {low:.0f}"
        parts.append(f"| {label} | {_right(within)} |")
    return "\n".join(parts) + "\n"


def lines_of_cases(cases: Sequence[tuple[int, Grade, str]]) -> str:
    """Truth and result of cases, as markdown."""
    lines = ["| case | runs | true | over just visible | result | residual |"]
    lines += ["| ---: | --- | --- | ---: | --- | --- |"]
    for number, g, error in cases:
        size = f"{g.ratio:.1f}" if np.isfinite(g.ratio) else ""
        # a bar in a message would end its cell
        said = f"failed: {error}".replace("|", "\\|") if error else _effects(g.said, g.verdict)
        gap = "" if error else f"{g.gap_before:.2f} to {g.gap_after:.2f}"
        lines.append(
            f"| {number} | {g.form} | {_effects(g.truth, 'nothing')} | {size} | {said} | {gap} |"
        )
    return "\n".join(lines) + "\n"


def _effects(effects: Sequence[tuple[str, str]], otherwise: str) -> str:
    return ", ".join(f"{kind} at {where}" for kind, where in effects) or otherwise


def _short(columns: list[str], column: int) -> str:
    """Heading of a narrow column."""
    name = columns[column]
    return SIGNS[name][0] if name in SIGNS else str(column + 1)


def _expected(row: str) -> str:
    """What is to be said of what is true."""
    return UNEXPLAINED if row in OUTSIDE else row


def _whole(figure: str) -> str:
    """A figure that breaks into a second line only before its bracket."""
    return " (".join(part.replace(" ", "\N{NO-BREAK SPACE}") for part in figure.split(" ("))


def _marked(count: int, *, right: bool) -> str:
    """A count of the confusion matrix; nothing in the place of zero."""
    if not count:
        return ""
    return f"**{count}**" if right else str(count)


def text(grades: Sequence[Grade]) -> str:
    """The same for a terminal; the columns of the matrix are numbered."""
    rows_of_summary = summary(grades)
    width = max(len(what) for what, _, _ in rows_of_summary)
    lines = [f"{what:<{width}}  {target:<14} {got}" for what, target, got in rows_of_summary]
    rows, columns, counts = confusion(grades)
    used = [c for c in range(len(columns)) if counts[:, c].any()]
    lines += ["", "confusion: rows true, columns result"]
    lines += [f"  [{i + 1}] {columns[c]}" for i, c in enumerate(used)]
    lines.append(" " * 22 + "".join(f"{f'[{i + 1}]':>5}" for i in range(len(used))))
    for r, row in enumerate(rows):
        if counts[r].any():
            cells = "".join(f"{counts[r, c] or '.':>5}" for c in used)
            lines.append(f"{row:<22}{cells}")
    return "\n".join(lines) + "\n"


METHODS = {
    "loose_gap": "`loose gap`",
    "sysid": "`mujoco.sysid`, all parameters free",
    "stepwise_bic": "stepwise selection, BIC",
}
"""Names in the table of methods."""
_METHODS_HEAD = (
    "method", "single effects correct", "effects found", "named effects that are there",
    "false alarms, nothing missing", "outside the catalogue, nothing named",
    "error of parameters, median", "held-out RMS residual after, median [noise sd]",
    "time, median [s]",
)  # fmt: skip


def methods_table(graded: Mapping[str, Mapping[int, Grade]]) -> str:
    """One line for each tool, on the cases that all tools with rows have, as markdown."""
    graded = {name: own for name, own in graded.items() if own}
    numbers = set.intersection(*(set(own) for own in graded.values()))
    lines = [
        f"{len(numbers)} cases that all methods have run: {_ranges(sorted(numbers))}.",
        "",
        "| " + " | ".join(_METHODS_HEAD) + " |",
        "| --- |" + " --- |" * (len(_METHODS_HEAD) - 1),
    ]
    for name, own in graded.items():
        cells = _method_cells([own[number] for number in sorted(numbers)])
        lines.append("| " + " | ".join((METHODS[name], *cells)) + " |")
    return "\n".join(lines)


def _method_cells(grades: Sequence[Grade]) -> tuple[str, ...]:
    """What one tool came to."""
    single = [g for g in grades if g.role == "single"]
    none = [g for g in grades if g.role == "none"]
    outside = [g for g in grades if g.role == "outside"]
    true = [g for g in grades if g.truth and g.role != "outside"]
    errors = [error for g in grades for error in g.parameter_error]
    after = [g.gap_after for g in true if np.isfinite(g.gap_after)]
    seconds = [g.seconds for g in grades if np.isfinite(g.seconds)]
    named = sum(len(g.said) for g in grades)
    return (
        _right(single),
        _found(true),
        share(sum(g.found for g in true), named) if named else "none named",
        share(sum(not g.right for g in none), len(none)),
        share(sum(g.verdict != NAMED for g in outside), len(outside)),
        f"{100 * np.median(errors):.1f} % of {len(errors)}" if errors else "none",
        _median(after),
        f"{np.median(seconds):.0f}" if seconds else "none",
    )


def _ranges(numbers: Sequence[int]) -> str:
    """Numbers as ranges: 1-3 7."""
    parts: list[list[int]] = []
    for number in numbers:
        if parts and number == parts[-1][-1] + 1:
            parts[-1].append(number)
        else:
            parts.append([number])
    return " ".join(f"{p[0]}-{p[-1]}" if len(p) > 1 else f"{p[0]}" for p in parts)
