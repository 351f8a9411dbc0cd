"""The leaderboard: stored scores as a table in the docs, a table for each suite."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from loose_env.errors import InvalidData
from loose_env.io import read_result_file, restored, whole_of
from scripts.study import write_between
from scripts.suites.gap.public.scoring import FORMAT, Count, Score, number

__all__ = ["PAGE", "leaderboard", "read_score", "stored_scores", "write_board"]

PAGE = Path(__file__).resolve().parents[4] / "docs" / "gap_benchmark.md"
"""Page of the leaderboard; scores lie in the folder of its name beside it."""
HEAD = (
    ("entry", "---"), ("cases right", "---:"), ("precision", "---:"), ("recall", "---:"),
    ("F1", "---:"), ("false alarms", "---:"), ("Brier", "---:"), ("calibration error", "---:"),
    ("parameter error", "---:"), ("coverage", "---:"), ("CPU [s]", "---:"),
)  # fmt: skip
"""Columns of the table and their alignment."""


def read_score(path: Path) -> Score:
    """Read ``score.json``.

    Raises
    ------
    InvalidData
        If it is missing or damaged.
    """

    def parse(text: str) -> Score:
        return restored(Score, whole_of(text, format=FORMAT, noun="score"), "score")

    return read_result_file(path, parse, noun="score")


def stored_scores() -> list[Path]:
    """Score files of the repository."""
    return sorted(PAGE.with_suffix("").glob("*.json"))


def leaderboard(scores: Sequence[Score]) -> str:
    """Scores as Markdown, the best F1 first, a table for each suite.

    Parameters
    ----------
    scores : sequence of Score
        Entries; names are different ones within a suite.

    Raises
    ------
    InvalidData
        If there are none, or two entries of a suite have one name.
    """
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
