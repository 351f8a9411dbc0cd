"""Grade of a `loose gap` result against the truth, and the table of many grades."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from scripts.suites.blind import columns_table, share
from scripts.suites.gap.cases import FORMAT
from scripts.suites.gap.worlds import WORLDS

Named = tuple[str, str]  # kind and place
Marks = dict[str, Any]  # marks of one case: numbers and words only, a row of the suite
UNEXPLAINED = "unexplained"


def _said(result: Mapping[str, Any], truth: Mapping[str, Any]) -> list[Named]:
    """Effects named, one at all joints as one at each, without those that do not count."""
    everywhere = {tuple(e) for true in truth["effects"] for e in _names_of(true) if e[1] == "all"}
    places: dict[str, list[str]] = {}
    for true in truth["effects"]:
        for kind, where in _names_of(true):
            places.setdefault(kind, []).append(where)
    found: list[Named] = []
    for effect in result.get("effects", ()) if result["verdict"] != "no_gap" else ():
        kind, where = str(effect["kind"]), str(effect["where"])
        if where == "all" and (kind, where) not in everywhere and kind in places:
            found += [(kind, place) for place in places[kind] if place != "all"]
            if len(set(places[kind])) < int(truth["joints"]):
                found.append((kind, where))  # at the other joints it is false
        else:
            found.append((kind, where))
    neutral = [tuple(name) for name in truth["neutral"]]
    return [
        name
        for name in dict.fromkeys(found)
        if name[1] not in truth["ignored"] and name not in neutral and (name[0], "*") not in neutral
    ]


def _names_of(true: Mapping[str, Any]) -> set[Named]:
    own = {(str(true["kind"]), str(true["where"]))}
    return own | {(kind, where) for each in true["accept"] for kind, where in each}


def _in_runs(result: Mapping[str, Any], each: Mapping[str, Any]) -> bool:
    """Whether an effect of some runs alone is said of these runs; true of one of all runs."""
    if not each.get("runs"):
        return True
    said = [
        {int(re.findall(r"\d+", Path(run).stem)[-1]) for way in own["mountings"] for run in way}
        for own in result.get("effects", ())
        if own.get("mountings")
    ]
    return {run + 1 for run in each["runs"]} in said


def grade(result: Mapping[str, Any], truth: Mapping[str, Any]) -> Marks:
    """Mark a result: what was found, what is false, which intervals hold the true value.

    An effect is found if one of the sets of names that its truth accepts is whole among the
    answers; an answer in any of these sets is not false.
    """
    if truth.get("format") != FORMAT:
        raise ValueError(f"the truth has format {truth.get('format')!r}; {FORMAT!r} is graded")
    outside, true = truth["role"] == "outside", truth["effects"]
    said = _said(result, truth)
    found = [
        not outside
        and any(all(tuple(e) in said for e in names) for names in each["accept"])
        and _in_runs(result, each)
        for each in true
    ]
    near = set().union(*(_names_of(each) for each in true)) if not outside else set()
    false = [name for name in said if name not in near]
    verdict = str(result["verdict"])
    right = all(found) and not false
    if truth["role"] == "none":  # unless something else is wrong with the recording
        right = right and (verdict != UNEXPLAINED or bool(truth["ignored"]))
    if outside:
        places = dict(result.get("verdicts") or {})
        told = verdict == UNEXPLAINED or any(
            UNEXPLAINED in str(places.get(word, ""))
            for each in true
            for word in (each["where"], f"joint{each['index'] + 1}")
        )
        right = told and not false
    held, errors = [], []
    for each, there in zip(true, found, strict=True):
        own = [e for e in result.get("effects", ())
               if (e["kind"], e["where"]) == (each["kind"], each["where"])]  # fmt: skip
        if there and own:
            hit, error = _values(each, own[0])
            held += hit
            errors += error
    return {
        "case": truth["case"], "world": truth["world"], "role": truth["role"],
        "machine": truth["machine"], "verdict": verdict, "right": bool(right),
        "truth": [[each["kind"], each["where"]] for each in true],
        "found": found, "false": [list(name) for name in false],
        "said": [list(name) for name in said],
        "held": held, "errors": errors,
    }  # fmt: skip


def failed(truth: Mapping[str, Any]) -> Marks:
    """Marks of a case for which there is no result: nothing is right."""
    marks = grade({"verdict": "failed", "effects": ()}, truth)
    return {**marks, "right": False}


def _values(true: Mapping[str, Any], effect: Mapping[str, Any]) -> tuple[list[bool], list[float]]:
    """Whether the intervals hold the true values, and the relative errors."""
    held, errors = [], []
    for name, value in true["values"].items():
        want = float(value["value"])
        if name in (effect.get("interval_95") or {}):
            low, high = (float(end) for end in effect["interval_95"][name])
            if name == "phase":  # the same after every turn
                want += 2 * np.pi * round((0.5 * (low + high) - want) / (2 * np.pi))
            held.append(bool(low <= want <= high))
        if name in (effect.get("parameters") or {}) and name == next(iter(true["values"])):
            neutral = 1.0 if name in ("gain", "factor") else 0.0
            off = float(effect["parameters"][name]) - want
            errors.append(abs(off) / max(abs(want - neutral), 1e-12))
    return held, errors


# ---------------------------------------------------------------------------------- table

Rows = Sequence[Marks]


def _share(hits: Iterable[Any]) -> str:
    own = [bool(hit) for hit in hits]
    return share(sum(own), len(own))


def _of(rows: Rows, role: str) -> list[Marks]:
    return [row for row in rows if row["role"] == role]


def _spread(rows: Rows, name: str, unit: str) -> str:
    own = [row[name] for row in rows if row.get(name) is not None]
    return f"{np.median(own):.3g}, {max(own):.3g} {unit}" if own else "none"


def _error(rows: Rows) -> str:
    own = [error for row in rows for error in row["errors"]]
    return f"{100 * np.median(own):.1f} %" if own else "none"


LINES: tuple[tuple[str, Callable[[Rows], str]], ...] = (
    ("one effect, right and nothing false beside | 92 %, each world 85 %",
     lambda rows: _share(row["right"] for row in _of(rows, "one"))),
    ("one effect, found | ", lambda rows: _share(all(row["found"]) for row in _of(rows, "one"))),
    ("two effects, both right and nothing false | 80 %",
     lambda rows: _share(row["right"] for row in _of(rows, "two"))),
    ("four to six effects, recall | 80 %",
     lambda rows: _share(hit for row in _of(rows, "many") for hit in row["found"])),
    ("four to six effects, precision | 90 %", lambda rows: _share(
        name not in row["false"] for row in _of(rows, "many") for name in row["said"])),
    ("nothing missing, nothing named | 98 %",
     lambda rows: _share(row["right"] for row in _of(rows, "none"))),
    ("one from outside, said so | 90 %",
     lambda rows: _share(row["right"] for row in _of(rows, "outside"))),
    ("true values inside the 95 % intervals | 93 %",
     lambda rows: _share(hit for row in rows for hit in row["held"])),
    ("error of the first parameter, median | ", _error),
    ("CPU time a case, median and largest | ", lambda rows: _spread(rows, "cpu", "s")),
    ("peak memory, median and largest | 1 GB", lambda rows: _spread(rows, "memory", "MB")),
    ("cases that failed, wrong in all of the above | 0",
     lambda rows: _share(row["verdict"] == "failed" for row in rows)),
)  # fmt: skip
"""Lines of the table: what and goal, and how it is counted."""


def table(rows: Rows) -> str:
    """The table of all worlds and of each, in Markdown, with Wilson's intervals."""
    worlds = {name: [row for row in rows if row["world"] == name] for name in WORLDS}
    columns = {"all": rows} | {name: own for name, own in worlds.items() if own}
    return columns_table(LINES, columns, first="| goal ")


def methods_table(tools: Mapping[str, Rows]) -> str:
    """The table with a column a tool, on the cases that all of them have."""
    names = set.intersection(*({row["case"] for row in rows} for rows in tools.values()))
    columns = {tool: [r for r in rows if r["case"] in names] for tool, rows in tools.items()}
    said = f"{len(names)} cases that all tools have run."
    return f"{said}\n\n{columns_table(LINES, columns, first='| goal ')}"


def words_of(row: Marks) -> str:
    """One line about a case."""
    true = ", ".join("@".join(name) for name in row["truth"]) or "nothing"
    said = ", ".join("@".join(name) for name in row["said"]) or row["verdict"]
    mark = "right" if row["right"] else "WRONG"
    return f"{row['case']} {row['world']:<6} {row['role']:<7} {mark}  true {true}  said {said}"
