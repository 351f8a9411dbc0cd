"""Scores of answers to the public benchmark, and the leaderboard."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from loose_env.errors import InvalidData
from loose_env.evaluation import expected_calibration_error
from loose_env.io import json_text, read_result_file, restored, whole_of, write_text
from scripts.study import write_between
from scripts.suites.gap.grading import (
    NAMED,
    Grade,
    grade,
    judged_intervals,
    matched,
    parameter_error,
    separable_by_data,
)
from scripts.suites.gap.public_suite import Answer, open_truths, read_answers, read_suite
from scripts.suites.gap.tables import share

FORMAT = "gap-score/1"
"""Format of ``score.json``."""
BINS = 5
"""Bins of the calibration error: a suite has some tens of named effects."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Count:
    """Hits among trials."""

    hits: int = 0
    """Trials that were right."""
    of: int = 0
    """All trials."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class CaseScore:
    """Marks of one case. They tell the truth: written only for suites that are open."""

    case: str
    """Name of the recording."""
    group: str
    """`none`, `single`, `pair`, `triple`, `outside` or `machine`."""
    truth: tuple[str, ...]
    """True effects, ``kind@where``."""
    answered: tuple[str, ...]
    """Named effects, ``kind@where``; the verdict alone where none is named."""
    right: bool
    """Verdict, kinds and locations all right, none too many."""
    found: int
    """Named effects that are there."""
    named: int
    """Named effects."""
    true: int
    """Effects that are there."""
    brier: float
    """Sum of (p - y)² over effects named or there; p is 0 for one that is not named."""
    probabilities: tuple[float, ...] = ()
    """Probabilities of the named effects."""
    hits: tuple[bool, ...] = ()
    """Whether each of them is there."""
    parameter_error: tuple[float, ...] = ()
    """Relative error of the parameters of each effect named by its own name."""
    covered: tuple[bool, ...] = ()
    """Whether each 95 % interval holds the truth."""
    cpu_seconds: float = math.nan
    """Processor time [s], NaN if not told."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Score:
    """The content of ``score.json``."""

    name: str
    """Name of the entry."""
    suite: str
    """Name of the suite."""
    identity: str
    """Identity of the suite: scores of different ones are not compared."""
    right: Count
    """Cases that are right in everything."""
    groups: Mapping[str, Count]
    """The same by group of cases."""
    found: int
    """TP: named effects that are there."""
    named: int
    """TP + FP: named effects."""
    true: int
    """TP + FN: effects of the catalogue that are there."""
    precision: float
    """TP / (TP + FP); NaN where nothing is named."""
    recall: float
    """TP / (TP + FN)."""
    f1: float
    """2 TP / (2 TP + FP + FN)."""
    false_alarms: Count
    """Cases with nothing missing that were not answered ``no_gap``."""
    brier: float
    """Sum of (p - y)² over effects named or there, over the number of cases."""
    calibration_error: float
    """Expected calibration error of the probabilities, in `BINS` bins; NaN where none is named."""
    parameter_error: float
    """Median relative error of the parameters; NaN where none was right."""
    coverage: Count
    """95 % intervals that hold the truth."""
    cpu_seconds: float
    """Median processor time of a case [s]; NaN if not told for every case."""
    cases: tuple[CaseScore, ...] = ()
    """Marks by case, of an open suite."""
    format: str = FORMAT
    """Format of the file."""


def score(folder: Path, answers: Path, *, name: str = "", opened: bool = False) -> Score:
    """Grade the answers to a suite, whose truths are checked against their commitments."""
    suite = read_suite(folder)
    given = read_answers(answers, suite)
    truths, secret = open_truths(folder, suite)
    cases = []
    for case, answer in given.items():
        ask = separable_by_data(secret.numbers[case], seed=int(secret.seed, 16))
        cases.append(mark_case(answer, truths[case], separable=functools.cache(ask)))
    found = total(
        cases, name=name or answers.resolve().name, suite=suite.name, identity=suite.identity
    )
    return found if opened else dataclasses.replace(found, cases=())


def mark_case(
    answer: Answer,
    truth: Mapping[str, Any],
    *,
    separable: Any = lambda effect, named: True,
) -> CaseScore:
    """Mark one answer."""
    marks: Grade = grade(answer.as_result(), truth, separable=separable)
    # grading takes an effect outside the catalogue for one that cannot be named
    true = () if marks.role == "outside" else marks.truth
    effects = answer.effects if answer.verdict == NAMED else ()
    match = matched(true, marks.said, separable, one_by_one=marks.role == "machine")
    own = [
        (truth["effects"][i], dataclasses.asdict(effects[j]))
        for i, j in match.items()
        if true[i] == marks.said[j]
    ]
    hits = tuple(j in match.values() for j in range(len(effects)))
    misses = len(true) - len(match)
    probabilities = tuple(effect.probability for effect in effects)
    return CaseScore(
        case=marks.case,
        group=marks.role,
        truth=tuple(f"{kind}@{where}" for kind, where in marks.truth),
        answered=tuple(f"{kind}@{where}" for kind, where in marks.said) or (answer.verdict,),
        right=marks.right,
        found=len(match),
        named=len(effects),
        true=len(true),
        brier=misses + sum((p - hit) ** 2 for p, hit in zip(probabilities, hits, strict=True)),
        probabilities=probabilities,
        hits=hits,
        parameter_error=tuple(e for each in own if math.isfinite(e := parameter_error(*each))),
        covered=tuple(judged.held for each in own for judged in judged_intervals(*each)),
        cpu_seconds=math.nan if answer.cpu_seconds is None else answer.cpu_seconds,
    )


def total(cases: Sequence[CaseScore], *, name: str, suite: str, identity: str) -> Score:
    """Micro-averages over all effects of all cases."""
    found, named, true = (
        sum(getattr(c, what) for c in cases) for what in ("found", "named", "true")
    )
    errors = [error for case in cases for error in case.parameter_error]
    covered = [held for case in cases for held in case.covered]
    healthy = [case for case in cases if case.group == "none"]
    groups = {
        group: _count([case.right for case in cases if case.group == group])
        for group in dict.fromkeys(case.group for case in cases)
    }
    return Score(
        name=name,
        suite=suite,
        identity=identity,
        right=_count([case.right for case in cases]),
        groups=dict(sorted(groups.items())),
        found=found,
        named=named,
        true=true,
        precision=_ratio(found, named),
        recall=_ratio(found, true),
        f1=_ratio(2 * found, named + true),
        false_alarms=_count([not case.right for case in healthy]),
        brier=_ratio(sum(case.brier for case in cases), len(cases)),
        calibration_error=expected_calibration_error(
            [p for case in cases for p in case.probabilities],
            [hit for case in cases for hit in case.hits],
            bins=BINS,
        ),
        parameter_error=float(np.median(errors)) if errors else math.nan,
        coverage=_count(covered),
        cpu_seconds=float(np.median([case.cpu_seconds for case in cases])) if cases else math.nan,
        cases=tuple(cases),
    )


def _count(trials: Sequence[bool]) -> Count:
    return Count(hits=sum(trials), of=len(trials))


def _ratio(hits: float, of: float) -> float:
    return hits / of if of else math.nan


def write_score(path: Path, found: Score) -> Path:
    """Write ``score.json``; the file is renamed into place."""
    return write_text(path, json_text(dataclasses.asdict(found)))


def table(found: Score) -> str:
    """A score for a terminal, with a line for each case of an open suite."""
    rows = [
        ("cases right", share(found.right.hits, found.right.of)),
        *(
            (f"  {group}", share(count.hits, count.of))
            for group, count in found.groups.items()
        ),
        ("precision over effects", share(found.found, found.named)),
        ("recall over effects", share(found.found, found.true)),
        ("F1", number(found.f1)),
        ("false alarms", share(found.false_alarms.hits, found.false_alarms.of)),
        ("Brier score per case", number(found.brier)),
        ("calibration error", number(found.calibration_error)),
        ("parameter error, median", number(found.parameter_error)),
        ("95 % intervals that hold", share(found.coverage.hits, found.coverage.of)),
        ("CPU time of a case, median [s]", number(found.cpu_seconds, digits=0)),
    ]  # fmt: skip
    lines = [f"{found.name} on {found.suite} ({found.identity})"]
    lines += [f"{what:<32}{value}" for what, value in rows]
    lines += [
        f"{case.case}  {'right' if case.right else 'WRONG'}  "
        f"true {' + '.join(case.truth) or 'nothing'}"
        f"  answered {' + '.join(case.answered)}"
        for case in found.cases
    ]
    return "\n".join(lines)


def number(value: float, *, digits: int = 3) -> str:
    """A number with so many decimals, "-" where there is none."""
    return f"{value:.{digits}f}" if math.isfinite(value) else "-"


PAGE = Path(__file__).resolve().parents[3] / "docs" / "accuracy.md"
"""Page of the leaderboard; scores lie in the folder of its name beside it."""
HEAD = (
    ("entry", "---"), ("cases right", "---:"), ("precision", "---:"), ("recall", "---:"),
    ("F1", "---:"), ("false alarms", "---:"), ("Brier", "---:"), ("calibration error", "---:"),
    ("parameter error", "---:"), ("coverage", "---:"), ("CPU [s]", "---:"),
)  # fmt: skip
"""Columns of the table and their alignment."""


def read_score(path: Path) -> Score:
    """Read ``score.json``."""

    def parse(text: str) -> Score:
        return restored(Score, whole_of(text, format=FORMAT, noun="score"), "score")

    return read_result_file(path, parse, noun="score")


def stored_scores() -> list[Path]:
    """Score files of the repository."""
    return sorted(PAGE.with_name("gap_benchmark").glob("*.json"))


def leaderboard(scores: Sequence[Score]) -> str:
    """Scores as Markdown, the best F1 first, a table for each suite."""
    if not scores:
        raise InvalidData("there are no scores; give files that the command score has written")
    parts = []
    for identity in dict.fromkeys(each.identity for each in scores):
        own = [each for each in scores if each.identity == identity]
        names = [each.name for each in own]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise InvalidData(f"two entries are called {twice[0]!r}; score one with another --name")
        first = own[0]
        parts.append(
            f"Suite `{first.suite}` (`{identity}`): {first.right.of} cases, {first.true} effects "
            "of the catalogue."
        )
        own.sort(key=lambda each: (-each.f1 if each.f1 == each.f1 else 1.0, each.brier, each.name))
        lines = [" | ".join(title for title, _ in HEAD), " | ".join(rule for _, rule in HEAD)]
        lines += [" | ".join(_cells(each)) for each in own]
        parts.append("\n".join(f"| {line} |" for line in lines))
    return "\n\n".join(parts)


def write_board(scores: Sequence[Score], page: Path = PAGE) -> None:
    """Write the leaderboard between its marks on a page."""
    write_between(page, leaderboard(scores), name="leaderboard")


def _cells(score: Score) -> list[str]:
    return [
        score.name.replace("|", "\\|"),
        _of(score.right),
        number(score.precision, digits=2),
        number(score.recall, digits=2),
        number(score.f1, digits=2),
        _of(score.false_alarms),
        number(score.brier, digits=2),
        number(score.calibration_error, digits=2),
        number(score.parameter_error),
        _of(score.coverage),
        number(score.cpu_seconds, digits=0),
    ]


def _of(count: Count) -> str:
    return f"{count.hits}/{count.of}" if count.of else "-"
