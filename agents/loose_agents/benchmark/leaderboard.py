"""Leaderboard of the benchmark: stored results as Markdown tables, paired on equal episodes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from loose_agents.base import hypothesis_prior
from loose_agents.benchmark.episodes import ENGINE, HIDDEN, SETS, TASKS, task_problem
from loose_agents.benchmark.results import Results, read_results
from loose_agents.sharded_play import bound_of
from loose_env.envs import difficulty_named
from loose_env.errors import InvalidData
from loose_env.evaluation import Interval, bootstrap_mean, expected_calibration_error, wilson
from loose_env.faults import UNSURE
from loose_env.typing import Array

RESULTS = Path(__file__).resolve().parents[3] / "docs" / "benchmark_results"
"""Results files of the repository."""
ADAPTIVE = "greedy"
"""Entry with which the others are compared."""
CLOSED_LOOP = (ADAPTIVE, "look_ahead")
"""Entries that choose records by results on the task's posterior; V values the better one."""

_HEAD = (
    "| entry | arms | return | over greedy | right % (95 %) | unsure % | false alarms % | missed % "
    "| records | calibration error | training records | ms a record |"
)

ByEntry = Mapping[str, Results]
"""Results of one set of one task, by entry."""


def results_path(folder: Path, task: str, set_name: str, entry: str) -> Path:
    """File of an entry: ``FOLDER/TASK/ENTRY.json``, with the set between if it is not "test"."""
    name = "".join(c if c.isalnum() or c in "-_.#" else "-" for c in entry)
    where = folder / task.removeprefix("loose_env/")
    return (where if set_name == "test" else where / set_name) / f"{name}.json"


def stored_results(folder: Path) -> list[Results]:
    """Read all results files below a folder, tasks and sets in their order."""
    found = [read_results(path) for path in sorted(folder.rglob("*.json"))]
    seen: set[tuple[str, str, str]] = set()
    for each in found:
        key = (each.task, each.set, each.entry)
        if key in seen:
            raise InvalidData(f"two entries of {each.task}, {each.set}, are called {each.entry!r}")
        seen.add(key)
    return sorted(found, key=lambda r: (TASKS.index(r.task), list(SETS).index(r.set), r.entry))


def value_tables(results: Sequence[Results]) -> str:
    """Value of stopping, of feedback and of choice on every task, paired, as Markdown."""
    lines = [
        "| task | arms | closed loop | return | V-stop | V-feedback | V over fixed sequence |",
        "|---|---:|---|---:|---:|---:|---:|",
    ]
    for task, set_name in product(TASKS, ("test", HIDDEN)):
        own = _entries(results, task, set_name)
        if ADAPTIVE not in own:
            continue
        lengths = _best(own, [name for name in own if name.startswith("fixed_")])
        sequence = _best(own, [name for name in own if name.startswith("fixed")])
        stopping, open_loop = (_best(own, [name]) for name in ("fixed", "open_loop"))
        closed = _best(own, CLOSED_LOOP)
        pairs = ((stopping, lengths), (closed, open_loop), (closed, sequence))
        assert closed is not None
        words = _short(task) + ", hidden" * (set_name == HIDDEN)
        told = [words, str(len(closed.truth)), closed.entry, _signed(closed.returns)]
        lines.append(_line([*told, *(_difference(*map(_returns, pair)) for pair in pairs)]))
    return "\n".join(lines)


def _best(own: ByEntry, names: Sequence[str]) -> Results | None:
    """Entry of the highest return among names, if one of them has played."""
    found = [own[name] for name in names if name in own]
    return max(found, key=lambda each: float(each.returns.mean()), default=None)


def _returns(of: Results | None) -> Array | None:
    return None if of is None else of.returns


def leaderboard(results: Sequence[Results]) -> str:
    """Entries of each task, the highest return first, then those out of distribution."""
    parts = []
    for task in TASKS:
        own = _entries(results, task, "test")
        if not own:
            continue
        lines = [_HEAD, "|---|" + "---:|" * (_HEAD.count("|") - 2), *agent_rows(own)]
        table = "\n".join(lines) + _bound_words(task, own)
        parts.append(f"### {task}\n\nOn the {ENGINE} engine:\n\n{table}")
        hidden = _entries(results, task, HIDDEN)
        if hidden:
            lines[2:] = agent_rows(hidden)
            parts.append(f"On the hidden set, {ENGINE} engine:\n\n" + "\n".join(lines))
    outside = outside_table(results)
    if outside:
        words = f"On the {ENGINE} engine, two faults at once on MuJoCo:"
        parts.append(f"### Out of distribution\n\n{words}\n\n{outside}")
    return "\n\n".join(parts)


def outside_table(results: Sequence[Results]) -> str:
    """Return and share right of the entries in and out of distribution, as Markdown.

    A row for every set that an entry has played, an entry a column; empty without any.
    """
    outside = [each for each in results if each.set not in ("test", HIDDEN)]
    if not outside:
        return ""
    entries = sorted({each.entry for each in outside}, key=lambda name: (name != ADAPTIVE, name))
    lines = [
        f"| task | episodes | arms | {' | '.join(entries)} |",
        "|---|---|---:|" + "---:|" * len(entries),
    ]
    for task in TASKS:
        if not any(each.task == task for each in outside):
            continue
        for set_name in SETS:
            own = _entries(results, task, set_name)
            played = [own[name] for name in entries if name in own]
            if not played:
                continue
            arms = sorted({len(each.truth) for each in played})
            cells = [
                f"{_signed(own[name].returns)}, {_share(_right(own[name]))}" if name in own else "-"
                for name in entries
            ]
            words = played[0].episodes.words
            lines.append(_line([_short(task), words, " to ".join(map(str, arms)), *cells]))
    return "\n".join(lines)


def agent_rows(own: ByEntry) -> list[str]:
    """Rows of one task's entries as Markdown, the highest return first."""
    greedy = own[ADAPTIVE].returns if ADAPTIVE in own else None
    ranked = sorted(own.values(), key=lambda each: (-float(each.returns.mean()), each.entry))
    return [_row(each, greedy) for each in ranked]


def _row(results: Results, greedy: Array | None) -> str:
    right, unsure, count = _right(results), _unsure(results), len(results.truth)
    low, high = wilson(int(right.sum()), count)
    healthy = np.array(results.truth) == results.verdicts.index("healthy")
    named = np.array(results.verdict) == results.verdicts.index("healthy")
    alarms = _share(~(named | unsure)[healthy])
    missed = _share(named[~healthy])
    over = "-" if results.entry == ADAPTIVE else _difference(results.returns, greedy)
    training = results.training_records
    return _line(
        [
            results.entry.replace("|", "\\|"),
            str(count),
            _signed(results.returns),
            over,
            f"{100 * right.mean():.1f} ({100 * low:.1f} to {100 * high:.1f})",
            _share(unsure),
            alarms,
            missed,
            f"{np.mean(results.records):.2f}",
            _calibration(results),
            "-" if training is None else f"{training:,}",
            "-" if results.cpu_seconds is None else f"{1e3 * results.cpu_seconds:.0f}",
        ]
    )


def _bound_words(task: str, own: ByEntry) -> str:
    """Lower bound on the mean number of records at the best entry's error."""
    players = {
        name: (each.information, each.guesses)
        for name, each in own.items()
        if each.information and each.guesses
    }
    if not players:
        return ""
    best = max(own.values(), key=lambda each: float(each.returns.mean()))
    problem = task_problem(task, best.episodes)
    shares = difficulty_named(problem.settings.difficulty).probabilities(problem.settings.kinds)
    bound = bound_of(hypothesis_prior(problem.hypotheses, shares), players)
    if bound is None:
        return ""
    error = 1 - float(_right(best).mean())
    return (
        f"\n\nBound: {bound.records(error):.2f} records on average at the error of "
        f"{best.entry}, {100 * error:.1f} %, which takes {np.mean(best.records):.2f}; no record "
        f"says more than {bound.information:.2f} nat ({bound.teller}, record {bound.record})."
    )


def _calibration(results: Results) -> str:
    """Expected calibration error of what was named."""
    confidence = np.array(results.confidence, dtype=float)  # NaN of an agent that keeps none
    told, right = np.isfinite(confidence), np.equal(results.truth, results.verdict)
    return f"{expected_calibration_error(confidence[told], right[told]):.3f}" if told.any() else "-"


def _entries(results: Sequence[Results], task: str, set_name: str) -> dict[str, Results]:
    return {each.entry: each for each in results if (each.task, each.set) == (task, set_name)}


def _right(results: Results) -> NDArray[np.bool_]:
    truth = np.array(results.truth)
    return np.asarray((truth == np.array(results.verdict)) & (truth >= 0))


def _unsure(results: Results) -> NDArray[np.bool_]:
    return np.asarray(np.array(results.verdict) == results.verdicts.index(UNSURE))


def _share(of: NDArray[np.bool_]) -> str:
    return f"{100 * float(np.mean(of)):.1f}" if len(of) else "-"


def _difference(first: Array | None, second: Array | None) -> str:
    """Paired difference on the episodes that both have played."""
    if first is None or second is None:
        return "-"
    both = min(len(first), len(second))
    return _signed(first[:both] - second[:both])


def _signed(values: Array) -> str:
    found: Interval = bootstrap_mean(values, rng=np.random.default_rng(0))
    return f"{found.estimate:+.3f} ± {found.half:.3f}"


def _short(task: str) -> str:
    return task.removeprefix("loose_env/")


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"
