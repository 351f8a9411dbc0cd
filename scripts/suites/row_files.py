"""Files of rows (JSON lines) that a suite adds to as its cases finish."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

__all__ = ["add", "kept"]


def kept(path: Path) -> list[dict[str, Any]]:
    """Rows of a file, none where there is none; a line that was cut off is left out."""
    if not path.is_file():
        return []
    rows = []
    for line in path.read_text("utf-8").splitlines():
        try:
            rows.append(json.loads(line))
        except ValueError:
            continue
    return rows


def add(path: Path, row: dict[str, Any]) -> None:
    """Append a row, on a line of its own also after one that was cut off."""
    cut = path.is_file() and not path.read_bytes().endswith(b"\n") and path.stat().st_size > 0
    with path.open("a", encoding="utf-8") as file:
        file.write("\n" * cut + json.dumps(row) + "\n")
