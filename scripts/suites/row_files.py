"""Files of rows (JSON lines) that a suite adds to as its cases finish."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

__all__ = ["kept"]


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
