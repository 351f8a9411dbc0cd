"""What blind suites share: numbers and phrases of cases, commitments to the truth, shares."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.evaluation import seed_of, wilson
from loose_env.io import write_text

FIRST_JUDGED = 10_000
"""First number that is drawn from a phrase."""


def numbers_of(words: Iterable[str]) -> list[int]:
    """Numbers of cases from words such as ``7`` and ``10000-10059``."""
    found: dict[int, None] = {}
    for word in words:
        ends = word.split("-")
        if (
            len(ends) > 2
            or not all(end.isdecimal() for end in ends)
            or int(ends[0]) > int(ends[-1])
        ):
            raise InvalidSetting(f"{word!r} is no case; give numbers as in 7 or 10000-10059")
        found.update(dict.fromkeys(range(int(ends[0]), int(ends[-1]) + 1)))
    return list(found)


def drawn_from(number: int, phrase: str, seed: int) -> int:
    """Number from which a case is drawn: a seed in development, the phrase when judged."""
    if number < FIRST_JUDGED:
        return seed
    if not phrase:
        raise InvalidSetting(
            f"case {number} is for judging: give a --phrase of which its draw is made "
            f"(numbers below {FIRST_JUDGED} are for development)"
        )
    return seed_of(phrase)


def share(hits: int, count: int) -> str:
    """A share in per cent with Wilson's 95 % interval."""
    if count == 0:
        return "none"
    low, high = wilson(hits, count)
    return f"{hits}/{count} = {100 * hits / count:.0f} % ({100 * low:.0f} to {100 * high:.0f})"


def columns_table(
    lines: Iterable[tuple[str, Callable[[Any], str]]],
    columns: Mapping[str, Any],
    first: str = "",
) -> str:
    """Table in Markdown: a line for each way to count, a column for each group of rows."""
    head = f"| {first}| {' | '.join(columns)} |"
    found = [head, re.sub(r"[^|]+", "---", head)]
    for words, cell in lines:
        found.append(f"| {words} | {' | '.join(cell(rows) for rows in columns.values())} |")
    return "\n".join(found)


# ---------------------------------------------------------- suites that are made for others


def commit(folder: Path, phrase: str, names: Sequence[str], protocol: Mapping[str, Any]) -> None:
    """Write what entrants are told, and commitments to the truth of the cases."""
    whole = json.dumps({**protocol, "cases": sorted(names)}, indent=1)
    write_text(folder / "protocol.json", whole + "\n")
    sealed = {name: _commitment(phrase, _truth(folder, name)) for name in sorted(names)}
    write_text(folder / "commitments.json", json.dumps(sealed, indent=1) + "\n")
    print(f"{len(sealed)} cases in {folder}; keep {folder / 'truth'} and the phrase back")


def committed(folder: Path) -> dict[str, str]:
    """Commitments of a suite that was made for others; none else."""
    path = folder / "commitments.json"
    return dict(json.loads(path.read_text("utf-8"))) if path.is_file() else {}


def sealed_truth(folder: Path, phrase: str, name: str) -> Mapping[str, Any]:
    """The sealed truth of a case, which is the committed one where there are commitments."""
    path, known = _truth(folder, name), committed(folder)
    if known and known.get(name) != _commitment(phrase, path):
        raise InvalidData(f"{path} is not the truth that commitments.json was made from")
    return cast(Mapping[str, Any], json.loads(path.read_text("utf-8")))


def _truth(folder: Path, name: str) -> Path:
    return folder / "truth" / f"{name}.json"


def _commitment(phrase: str, truth: Path) -> str:
    """SHA-256 of the phrase and a file of truth: neither can be changed afterwards."""
    return hashlib.sha256(phrase.encode() + truth.read_bytes()).hexdigest()
