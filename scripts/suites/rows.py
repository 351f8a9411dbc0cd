"""Rows of a suite in JSON lines: run and resumed case by case, with a hash of the code."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, TypeVar

from loose_env.errors import InvalidSetting

Row = dict[str, Any]
Key = TypeVar("Key", int, str)


def kept(path: Path) -> list[Row]:
    """Rows of a file, none where there is none; a line that was cut off is left out."""
    rows = []
    for line in path.read_text("utf-8").splitlines() if path.is_file() else ():
        try:
            rows.append(json.loads(line))
        except ValueError:
            continue
    return rows


def add(path: Path, row: Row) -> None:
    """Append a row, on a line of its own also after one that was cut off."""
    path.parent.mkdir(parents=True, exist_ok=True)
    cut = path.is_file() and not path.read_bytes().endswith(b"\n") and path.stat().st_size > 0
    with path.open("a", encoding="utf-8") as file:
        file.write("\n" * cut + json.dumps(row) + "\n")


def run_cases(
    numbers: Iterable[Key],
    work: Callable[[Key], Row],
    path: Path,
    *,
    workers: int = 1,
    say: Callable[[Row], str] = str,
    key: str = "number",
) -> list[Row]:
    """Rows of the cases asked for, in order; those that the file lacks are run and appended."""
    from loose_agents.jobs import BackendSettings, results_of

    asked = list(dict.fromkeys(numbers))
    rows = {row[key]: row for row in kept(path)}
    missing = [number for number in asked if number not in rows]
    found = results_of(work, missing, BackendSettings(workers=workers))
    for count, (_, row) in enumerate(found, start=1):
        add(path, row)
        rows[row[key]] = row
        print(f"{count}/{len(missing)} {say(row)}", flush=True)
    return [rows[number] for number in asked]


def code_hash(*places: Path) -> str:
    """Hash of Python files and of those in folders."""
    digest = hashlib.sha256()
    for place in places:
        for file in sorted(place.rglob("*.py")) if place.is_dir() else [place]:
            digest.update(file.name.encode() + file.read_bytes())
    return digest.hexdigest()[:16]


def check_code(rows: Sequence[Row], code: str, path: Path) -> None:
    """Refuse rows that other code made."""
    others = {row["code"] for row in rows} - {code}
    if others:
        raise InvalidSetting(f"{path} has rows of other code ({', '.join(sorted(others))}); "
                             "--afresh removes them")  # fmt: skip
