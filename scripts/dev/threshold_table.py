"""Print the table of the decision thresholds of `loose gap`, as docs/gap.md shows it.

Usage: python -m scripts.dev.threshold_table [--docs]
"""

from __future__ import annotations

import argparse
import re
from pathlib import Path

from loose_agents.execution.script_errors import errors_in_one_line
from loose_agents.execution.study import write_between

__all__ = ["PAGE", "SOURCE", "main", "threshold_table"]

ROOT = Path(__file__).resolve().parents[2]
SOURCE = ROOT / "loose_env" / "gap" / "settings.py"
PAGE = ROOT / "docs" / "gap.md"
_ENTRY = re.compile(
    r'^(?:# (?P<part>[^\n]+)|(?P<name>[A-Z][A-Z_]+) = (?P<value>\S+)\n"""(?P<meaning>.+?)""")$',
    re.MULTILINE | re.DOTALL,
)


def threshold_table(source: str) -> str:
    r"""Markdown table of the constants of a module, their docstrings as meaning.

    Examples
    --------
    >>> print(threshold_table('# Search\nLEAST_Z = 3.0\n\"\"\"Smallest z-score.\"\"\"\n'))
    | constant | value | meaning and reason |
    |---|---|---|
    | **Search** | | |
    | `LEAST_Z` | 3.0 | Smallest z-score |
    """
    rows = ["| constant | value | meaning and reason |", "|---|---|---|"]
    for entry in _ENTRY.finditer(source):
        if entry["part"]:
            rows.append(f"| **{entry['part']}** | | |")
        else:
            meaning = " ".join(entry["meaning"].split()).rstrip(".")
            rows.append(f"| `{entry['name']}` | {entry['value']} | {meaning} |")
    return "\n".join(rows)


def main() -> None:
    """Print the table, or write it into the page."""
    with errors_in_one_line("threshold_table"):
        _run()


def _run() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--docs", action="store_true", help="write it into docs/gap.md")
    table = threshold_table(SOURCE.read_text(encoding="utf-8"))
    if parser.parse_args().docs:
        write_between(PAGE, table)
    else:
        print(table)


if __name__ == "__main__":
    main()
