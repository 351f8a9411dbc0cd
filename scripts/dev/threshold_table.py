"""Print the decision thresholds of a part as the table of its page.

Usage: python -m scripts.dev.threshold_table [doctor | gap | instrument] [--docs]
"""

from __future__ import annotations

import argparse
import re
from pathlib import Path

from loose_env.cli.command import errors_in_one_line
from scripts.study import write_between

__all__ = ["PARTS", "main", "threshold_table"]

ROOT = Path(__file__).resolve().parents[2]
PARTS = {
    "gap": (ROOT / "loose_env/gap/settings.py", ROOT / "docs/gap.md"),
    "doctor": (ROOT / "loose_env/doctor/thresholds.py", ROOT / "docs/doctor.md"),
    "instrument": (
        ROOT / "loose_env/instrument/settings/thresholds.py",
        ROOT / "docs/instrument.md",
    ),
}
"""Part -> the module of its thresholds, and the page that has their table."""
_ENTRY = re.compile(
    r"^(?:# (?P<part>[^\n]+)"
    r'|(?P<name>[A-Z][A-Z_0-9]+) = (?P<value>[^\n]+)\n"""(?P<meaning>.+?)""")$',
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
    rows, part = ["| constant | value | meaning and reason |", "|---|---|---|"], ""
    for entry in _ENTRY.finditer(source):
        if entry["part"]:
            part = f"| **{entry['part']}** | | |"
        else:
            if part:  # sections without constants have no heading
                rows.append(part)
                part = ""
            meaning = " ".join(entry["meaning"].split()).rstrip(".")
            rows.append(f"| `{entry['name']}` | {entry['value']} | {meaning} |")
    return "\n".join(rows)


def main() -> None:
    """Print the table, or write it into the page."""
    with errors_in_one_line("threshold_table"):
        _run()


def _run() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("part", nargs="?", default="gap", choices=PARTS)
    parser.add_argument("--docs", action="store_true", help="write it into the page of the part")
    chosen = parser.parse_args()
    source, page = PARTS[chosen.part]
    table = threshold_table(source.read_text(encoding="utf-8"))
    if chosen.docs:
        write_between(page, table)
    else:
        print(table)


if __name__ == "__main__":
    main()
