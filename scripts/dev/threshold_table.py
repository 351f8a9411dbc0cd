"""Print the decision thresholds of a part as the table of its page.

Usage: python -m scripts.dev.threshold_table [doctor | gap | instrument] [--docs]
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional

from loose_env.cli.command import command, one_of
from scripts.study import write_between

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


@dataclass(frozen=True, kw_only=True)
class Options:
    """Part and place of the table."""

    part: Positional[Annotated[str, one_of(tuple(PARTS))]] = "gap"
    """Part."""
    docs: bool = False
    """Write it into the page of the part."""


def write(options: Options) -> None:
    """Print the table, or write it into the page."""
    source, page = PARTS[options.part]
    table = threshold_table(source.read_text(encoding="utf-8"))
    if options.docs:
        write_between(page, table)
    else:
        print(table)


def main() -> None:
    """Write the table, with errors in one line."""
    command("threshold_table", __doc__, Options, write)


if __name__ == "__main__":
    main()
