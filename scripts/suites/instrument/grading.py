"""Marks of answers against sealed truths, and their tables in Markdown with Wilson's intervals."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from operator import itemgetter
from typing import Any

import numpy as np

from scripts.suites.blind import columns_table, share
from scripts.suites.instrument.cases import CLASSES, GROWS_FROM, HEALTHY, SHEETS
from scripts.suites.instrument.sensing import DAMAGES

Marks = dict[str, Any]
VERDICTS = ("loose", "tight", "open", "refused")
KINDS = ("structural_looseness", "backlash")
WAYS = ("alone", "reference")
"""Ways in which each case is judged: without and with the healthy reference."""
TITLES = {"alone": "Without a reference", "reference": "With a reference"}


def unfit(answer: Any) -> str:
    """Reason for which an answer does not keep to the protocol; empty if it does."""
    try:
        if answer["verdict"] not in VERDICTS:
            return f"verdict {answer['verdict']!r}; give one of {', '.join(VERDICTS)}"
        for place in answer.get("places", ()):
            if place["kind"] not in KINDS or not isinstance(place["at"], str):
                return f"place {place['kind']!r} at {place['at']!r}; give a kind of {KINDS}"
            if not 0 <= float(place["probability"]) <= 1:
                return f"probability {place['probability']}; give 0 to 1"
            way = place.get("direction")
            if way is not None and (len(way) != 3 or not np.isfinite(np.array(way, float)).all()):
                return f"direction {way}; give three numbers or null"
        bool(answer["settled"]), dict(answer.get("tested") or {})
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        return f"{type(error).__name__} {error}; see the protocol in scripts.suites.instrument.run"
    return ""


def grade(answer: Mapping[str, Any], truth: Mapping[str, Any]) -> Marks:
    """Marks of an answer: found, place, direction, and what it said was tested."""
    places = [(p["kind"], p["at"], p.get("direction")) for p in answer.get("places", ())]
    named = [place[:2] for place in places]
    index = {name: i for i, name in enumerate(truth["bodies"])}
    index.update({name: i for i, name in enumerate(truth["joints"])})
    opened = [f for f in truth["faults"] if truth["opened"].get(_name(f))]
    shut = [_name(f) for f in truth["faults"] if not truth["opened"].get(_name(f))]
    true = {(f["kind"], f["at"]): f for f in opened}
    tested = {str(key): value for key, value in dict(answer.get("tested") or {}).items()}
    loose = answer["verdict"] == "loose"
    first = named[0] if named else None
    at_base = loose and first == ("structural_looseness", truth["base"])
    near = any(
        place in true
        or any(abs(index.get(place[1], -9) - fault["index"]) <= 1 for fault in true.values())
        for place in named[:2]
    )
    error = None
    if first in true and true[first]["direction"] is not None and places[0][2] is not None:
        way = np.array(places[0][2], float)
        cosine = abs(way @ np.array(true[first]["direction"])) / max(np.linalg.norm(way), 1e-12)
        error = float(np.degrees(np.arccos(min(1.0, cosine))))
    settled = bool(answer["settled"])
    called_tight = answer["verdict"] == "tight" or any(tested.get(name) == "tight" for name in shut)
    said = bool(answer.get("remarks")) or bool(answer.get("remedy"))
    return {
        "verdict": answer["verdict"], "settled": settled, "loose": loose,
        "opened": [fault["kind"] for fault in opened], "shut": len(shut),
        "alarm": loose and not truth["faults"]
        and not (truth["kind"] == "base" and at_base),
        "first": first in true, "near": near,
        "both": len(true) == 2 and all(name in named[:3] for name in true),
        "several": bool(answer.get("several")),
        "direction": error,
        "wrong": settled and (
            (loose and first not in true and not (truth["kind"] == "base" and at_base))
            or (answer["verdict"] == "tight" and bool(true))
        ),
        "told": all(tested.get(name) == "not tested" for name in shut),
        "tight_shut": bool(shut) and not true and called_tight,
        "places": [f"{kind}@{at}" for kind, at in named[:3]],
        "dumb": answer["verdict"] in ("open", "refused") and not said,
        "said": said, "remedy": bool(answer.get("remedy")),
    }  # fmt: skip


def failed(truth: Mapping[str, Any]) -> Marks:
    """Marks of a case for which there is no answer."""
    marks = grade({"verdict": "failed", "settled": False}, truth)
    return {**marks, "dumb": True}


def _name(fault: Mapping[str, Any]) -> str:
    return f"{fault['kind']}@{fault['at']}"


# ----------------------------------------------------------------------------------- tables


Rows = Sequence[Mapping[str, Any]]
Cell = Callable[[Rows], str]


def _line(chosen: Callable[[Any], bool], hit: Callable[[Any], bool]) -> Cell:
    def cell(rows: Rows) -> str:
        own = [row for row in rows if chosen(row)]
        return share(sum(bool(hit(row)) for row in own), len(own))

    return cell


def _angle(share_of: float) -> Cell:
    def cell(rows: Rows) -> str:
        own = [row["direction"] for row in rows if row["direction"] is not None]
        return f"{np.quantile(own, share_of):.1f}° ({len(own)})" if own else "none"

    return cell


def _median(name: str, unit: str) -> Cell:
    def cell(rows: Rows) -> str:
        own = [row[name] for row in rows if row.get(name) is not None]
        return f"{np.median(own):.3g} {unit}" if own else "none"

    return cell


def _all(row: Any) -> bool:
    return True


def _opened(row: Any) -> bool:
    return bool(row["opened"])


def _found(row: Any) -> bool:
    return _opened(row) and bool(row["loose"])


def _two(row: Any) -> bool:
    return len(row["opened"]) == 2


def _shut(row: Any) -> bool:
    return row["shut"] > 0 and not row["opened"]


def _of(name: str, value: Any) -> Callable[[Any], bool]:
    return lambda row: row[name] == value


LINES: tuple[tuple[str, Cell], ...] = (
    ("found, of faults that opened", _line(_opened, itemgetter("loose"))),
    ("  a seat alone", _line(_of("opened", [KINDS[0]]), itemgetter("loose"))),
    ("  play alone", _line(_of("opened", [KINDS[1]]), itemgetter("loose"))),
    ("  two at once", _line(_two, itemgetter("loose"))),
    ("false alarms", _line(_of("role", "healthy"), itemgetter("alarm"))),
    *((f"  {kind}", _line(_of("kind", kind), itemgetter("alarm"))) for kind in HEALTHY),
    ("settled and right, of those found", _line(_found, lambda r: r["settled"] and r["first"])),
    ("first place right, of those found", _line(_found, itemgetter("first"))),
    ("first two places right or a neighbour, of those found", _line(_found, itemgetter("near"))),
    ("settled and wrong, of all", _line(_all, itemgetter("wrong"))),
    ("two at once: both in the first three places", _line(_two, itemgetter("both"))),
    ("two at once: several said", _line(_two, itemgetter("several"))),
    ("several said of one or none", _line(lambda r: not _two(r), itemgetter("several"))),
    ("direction, median", _angle(0.5)),
    ("direction, 90th percentile", _angle(0.9)),
    ("correct files refused", _line(_all, _of("verdict", "refused"))),
    ("no verdict, or open without a remark", _line(_all, itemgetter("dumb"))),
    ("faults that never opened called tight", _line(_shut, itemgetter("tight_shut"))),
    ("faults that never opened said to be not tested", _line(_shut, itemgetter("told"))),
    ("faults that never opened called loose", _line(_shut, itemgetter("loose"))),
    ("shaking, median", _median("shaken", "s")),
    ("CPU time of a diagnosis, median", _median("cpu", "s")),
)
"""Lines of the table: what, and how it is counted."""


def of_way(rows: Rows, way: str) -> list[dict[str, Any]]:
    """Rows with the marks of one way of judging beside what belongs to the case."""
    return [{**row, **row[way]} for row in rows if way in row]


def table(rows: Rows) -> str:
    """Tables without and with reference: all classes but hobby machines, and each class."""
    parts = []
    for way in WAYS:
        own = of_way(rows, way)
        columns: dict[str, Rows] = {"all": _without_hobby(own)}
        for name in CLASSES:
            each = [row for row in own if row["machine"] == name]
            columns |= {name + " (hobby, apart)" * SHEETS[name].hobby: each} if each else {}
        parts += [f"## {TITLES[way]}, {len(columns['all'])} cases", columns_table(LINES, columns)]
    return "\n\n".join(parts)


def variants_table(tools: Mapping[str, Rows]) -> str:
    """The lines that tell, a row for each variant, on the cases that all of them have."""
    numbers = set.intersection(*({row["number"] for row in rows} for rows in tools.values()))
    lines = [(words, cell) for words, cell in LINES if words in _TELLING]
    parts = []
    for way in WAYS:
        parts += [f"## {TITLES[way]}, {len(numbers)} cases", "",
                  f"| | {' | '.join(words for words, _ in lines)} |",
                  "|---|" + "---|" * len(lines)]  # fmt: skip
        for name, rows in tools.items():
            own = [r for r in _without_hobby(of_way(rows, way)) if r["number"] in numbers]
            parts.append(f"| {name} | {' | '.join(_short(cell(own)) for _, cell in lines)} |")
        parts.append("")
    return "\n".join(parts)


_TELLING = (
    "found, of faults that opened", "false alarms", "settled and right, of those found",
    "first place right, of those found", "settled and wrong, of all",
)  # fmt: skip


def _short(cell: str) -> str:
    """Counts of a cell without share and interval: variants share their cases."""
    return cell.split(" = ")[0]


def _without_hobby(rows: Rows) -> Rows:
    return [row for row in rows if not SHEETS[row["machine"]].hobby]


def damaged_table(rows: Rows) -> str:
    """Damaged files by damage: refused or remarked upon, silent, failed."""
    lines = []
    for way in WAYS:
        own = of_way(rows, way)
        lines += [f"## {TITLES[way]}, damaged files", "",
                  "| damage | refused with a remedy | or another verdict, not wrong, with a "
                  "remark | silent or wrong | no answer |", "|---|---|---|---|---|"]  # fmt: skip
        for kind in (*DAMAGES, "all"):
            each = [row for row in own if kind in (row["damage"], "all")]
            if not each:
                continue
            refused = [row["verdict"] == "refused" and row["remedy"] for row in each]
            none = [row["verdict"] == "failed" for row in each]
            told = [
                row["said"] and row["verdict"] in ("loose", "tight", "open")
                and not (row["wrong"] or row["alarm"])
                for row in each
            ]  # fmt: skip
            silent = len(each) - sum(refused) - sum(none) - sum(told)
            cells = [share(n, len(each)) for n in (sum(refused), sum(told), silent, sum(none))]
            lines.append(f"| {kind} | {' | '.join(cells)} |")
        lines.append("")
    return "\n".join(lines)


def months_table(rows: Rows) -> str:
    """Series of months: alarms before the fault grew, months until the first alarm after."""
    lines = ["| | all |", "|---|---|"]
    grown = [row for row in rows if row["role"] == "one"]
    late, missed = [], 0
    for row in grown:
        after = [m for m, a in enumerate(row["alarms"], start=1) if a and m >= GROWS_FROM]
        late += [after[0] - GROWS_FROM] if after else []
        missed += not after
    before = [a for row in grown for a in row["alarms"][: GROWS_FROM - 1]]
    never = [a for row in rows if row["role"] == "healthy" for a in row["alarms"]]
    delays = f"median {np.median(late):.1f}, most {max(late)}" if late else "none"
    lines += [
        f"| months from the fault's beginning to the first alarm | {delays} |",
        f"| growing faults without any alarm | {share(missed, len(grown))} |",
        f"| alarms in months before the fault | {share(sum(before), len(before))} |",
        f"| alarms in months of machines without a fault | {share(sum(never), len(never))} |",
        f"| sessions without an answer | {sum(row['unanswered'] for row in rows)} |",
    ]
    return "\n".join(lines)


def words_of(row: Mapping[str, Any]) -> str:
    """One line about a case."""
    line = f"{row['number']:5d} {row['case']} {row['machine']:<10} {row['role']:<7} {row['kind']}"
    if "alarms" in row:
        return f"{line}  alarms {''.join('x' if a else '.' for a in row['alarms'])}"
    for way in WAYS:
        if way in row:
            marks = row[way]
            mark = "settled" if marks["settled"] else ""
            line += f"  {way}: {marks['verdict']} {mark} {' '.join(marks['places'][:2])}"
    return line
