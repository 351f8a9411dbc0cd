"""The tables of a comparison for a terminal, at most 120 columns wide."""

from __future__ import annotations

import math
import textwrap
from collections import Counter
from collections.abc import Mapping, Sequence

from loose_env.evaluation import (
    Calibration,
    Crossing,
    Division,
    Interval,
    Row,
    Standing,
    ratio_names,
)

WIDTH = 120
_NAME = 20  # of an agent; longer ones are cut in the middle


def main_table(found: Sequence[Standing], *, reference: str | None = None) -> str:
    """Lay the standings out: one line an agent, and the meaning of the columns below."""
    whole = _main(found, reference, compact=False)
    if len(whole.splitlines()[-1]) > WIDTH or len(whole.splitlines()[2]) > WIDTH:
        whole = _main(found, reference, compact=True)
    words = (
        "accuracy: verdicts equal to the hidden fault, with Wilson's 95 % interval; location: "
        "verdicts with its link or joint; false alarms: healthy arms called faulty [%]; missed "
        "faults: faulty arms called healthy [%]; poses, records, time of excitation and return: "
        "means over all episodes; ±: half the 95 % bootstrap interval."
    )
    if reference is not None:
        words += (
            f" Last column: return less that of {reference} on the same arms, with its paired "
            "bootstrap interval."
        )
    return f"{whole}\n\n{_filled(words)}"


def _main(found: Sequence[Standing], reference: str | None, *, compact: bool) -> str:
    unsure = any(s.unsure for s in found)
    lines = []
    for s in found:
        line = {
            ("agent", ""): s.agent,
            (
                "accuracy",
                "% (95 %)",
            ): f"{100 * s.success:.1f} ({100 * s.low:.1f}-{100 * s.high:.1f})",
            ("loca-", "tion %"): _share(s.link_success),
            ("false", "alarms"): _share(s.false_alarms),
            ("missed", "faults"): _share(s.misses),
            **({("unsure", "%"): _share(s.unsure)} if unsure else {}),
            ("poses", ""): f"{s.poses:.2f}",
            ("records", ""): f"{s.records:.2f}" + _margin(s.records_interval),
            ("time", "s"): f"{s.seconds:.2f}",
            ("return", ""): f"{s.reward:+.3f}",
        }
        if reference is not None:
            shown = "reference" if s.agent == reference else _ends(s.lead, compact=compact)
            line["over reference", "(95 %)" if not compact else ""] = shown
        lines.append(line)
    head = [[name for name, _ in lines[0]], [unit for _, unit in lines[0]]]
    return _table(head, [list(line.values()) for line in lines])


def crossed_table(found: Crossing) -> str:
    """Lay estimators crossed with policies out."""
    lines = []
    for policy in found.policies:
        line = [policy]
        for estimator in found.estimators:
            s = found.cells.get((policy, estimator))
            shown = (
                "-" if s is None else f"{100 * s.success:.1f} / {s.records:.2f} / {s.reward:+.3f}"
            )
            line.append(shown)
        lines.append(line)
    heading = "Policies (lines) and estimators (columns): accuracy [%] / mean records / mean return"
    return _parts(heading, [["policy", *found.estimators]], lines)


def division_table(division: Division) -> str:
    """Lay one division out: accuracy and mean records of each group."""
    first = next(iter(division.cells.values()))
    head = ["agent", *division.groups]
    counts = ["arms", *(str(cell.episodes) for cell in first)]
    lines = [
        [agent, *(_pair(cell.success, cell.records) for cell in cells)]
        for agent, cells in division.cells.items()
    ]
    heading = f"By {division.heading}: accuracy [%] / mean records"
    return _parts(heading, [head, counts], lines)


def calibration_table(found: Sequence[Calibration]) -> str:
    """Lay out the calibration of the probabilities."""
    records = len(found[0].by_record) - 1
    head = ["agent", "ECE", "verdict", "log score"]
    head += [*(f"rec. {k}" for k in range(1, records + 1)), f"{records + 1}+"]
    head += [name.replace("below ", "<").replace("above ", ">") for name in ratio_names()]
    lines = [
        [
            c.agent,
            f"{c.error:.3f}",
            f"{c.at_verdict:.3f}",
            f"{c.score:.3f}",
            *(_error(e) for e in (*c.by_record, *c.by_ratio)),
        ]
        for c in found
    ]
    words = (
        "ECE: expected calibration error of the best hypothesis after every record; then at the "
        "verdicts; log score: mean ln of the truth's probability there; then the error after "
        "record 1, 2, ... and by seat drive over friction (faulty arms). No agent sees the "
        "friction: sorted by it even the exact posterior is off."
    )
    return f"{_parts('Calibration', [head], lines)}\n\n{_filled(words)}"


def curve_table(curves: Mapping[str, Sequence[float]]) -> str:
    """Lay out success after record 1, 2, ... of agents that may not stop."""
    most = max(len(curve) for curve in curves.values())
    lines = [
        [agent, *(_share(share) for share in curve), *[""] * (most - len(curve))]
        for agent, curve in sorted(curves.items(), key=lambda pair: -pair[1][-1])
    ]
    heading = "Accuracy [%] after so many records, without stopping"
    return _parts(heading, [["agent", *(str(k + 1) for k in range(most))]], lines)


def trainings_table(found: Mapping[str, Mapping[str, Interval]], runs: Mapping[str, int]) -> str:
    """Lay out the interquartile means of agents that were trained several times."""
    lines = [
        [
            agent,
            str(runs[agent]),
            _range(by["success"], 100, 1),
            _range(by["records"], 1, 2),
            _range(by["reward"], 1, 3),
        ]
        for agent, by in found.items()
    ]
    words = (
        "Interquartile mean over trainings with stratified bootstrap intervals (Agarwal et al., "
        "NeurIPS 2021)."
    )
    head = [["agent", "trainings", "accuracy [%] (95 %)", "records (95 %)", "return (95 %)"]]
    return f"{_parts('Several trainings', head, lines)}\n\n{_filled(words)}"


def mistakes(agent: str, rows: Sequence[Row], *, most: int = 5) -> str:
    """List the most frequent confusions of an agent; empty if it made no mistake.

    Examples
    --------
    >>> rows = [dict(truth="backlash@joint1", verdict="healthy")] * 3
    >>> print(mistakes("thesis", rows))
    Most frequent mistakes of thesis: backlash@joint1 taken for healthy (3).
    """
    wrong = Counter(
        (str(row["truth"]), row["verdict"]) for row in rows if row["verdict"] != row["truth"]
    )
    if not wrong:
        return ""
    said = [
        f"{truth} {'without a verdict' if named is None else f'taken for {named}'} ({count})"
        for (truth, named), count in wrong.most_common(most)
    ]
    return _filled(f"Most frequent mistakes of {agent}: {'; '.join(said)}.")


def _filled(words: str) -> str:
    return textwrap.fill(words, 100)


def _parts(heading: str, head: Sequence[Sequence[str]], lines: Sequence[Sequence[str]]) -> str:
    """A table; columns that do not fit go into a further table below."""
    widths = _widths([*head, *lines])
    parts: list[list[int]] = [[]]
    for k in range(1, len(widths)):
        used = widths[0] + sum(widths[j] + 2 for j in parts[-1])
        if parts[-1] and used + widths[k] + 2 > WIDTH:
            parts.append([])
        parts[-1].append(k)

    def chosen(rows: Sequence[Sequence[str]], part: Sequence[int]) -> list[list[str]]:
        return [[row[k] for k in (0, *part)] for row in rows]

    tables = [_table(chosen(head, part), chosen(lines, part)) for part in parts]
    return f"{heading}\n\n" + "\n\n".join(tables)


def _table(head: Sequence[Sequence[str]], lines: Sequence[Sequence[str]]) -> str:
    """Columns to the right, the first to the left, a rule below the head."""
    lines = [[_short(line[0]), *line[1:]] for line in lines]
    widths = _widths([*head, *lines])

    def written(line: Sequence[str]) -> str:
        cells = [cell.rjust(width) for cell, width in zip(line[1:], widths[1:], strict=True)]
        return "  ".join([line[0].ljust(widths[0]), *cells]).rstrip()

    rule = "-" * (sum(widths) + 2 * (len(widths) - 1))
    return "\n".join([*map(written, head), rule, *map(written, lines)])


def _widths(lines: Sequence[Sequence[str]]) -> list[int]:
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return [min(widths[0], _NAME), *widths[1:]]


def _short(name: str) -> str:
    if len(name) <= _NAME:
        return name
    kept = (_NAME - 2) // 2
    return f"{name[: _NAME - 2 - kept]}..{name[-kept:]}"


def _share(share: float) -> str:
    return "-" if math.isnan(share) else f"{100 * share:.1f}"


def _pair(success: float, records: float) -> str:
    return "-" if math.isnan(success) else f"{100 * success:.1f} / {records:.2f}"


def _error(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.3f}"


def _margin(interval: Interval | None) -> str:
    return "" if interval is None else f" ±{interval.half:.2f}"


def _ends(interval: Interval | None, *, compact: bool) -> str:
    if interval is None:
        return ""
    if compact:
        return f"{interval.estimate:+.3f} ±{interval.half:.3f}"
    return f"{interval.estimate:+.3f} ({interval.low:+.3f}, {interval.high:+.3f})"


def _range(i: Interval, scale: float, digits: int) -> str:
    low, high = (f"{scale * end:.{digits}f}" for end in (i.low, i.high))
    return f"{scale * i.estimate:.{digits}f} ({low} to {high})"
