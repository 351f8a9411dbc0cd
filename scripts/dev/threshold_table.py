"""Print the decision thresholds of a part as a table, with unit and reason.

Usage: python -m scripts.dev.threshold_table [doctor | gap | instrument]
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional

from loose_env.cli.command import command, one_of

ROOT = Path(__file__).resolve().parents[2]
PARTS = {
    "gap": ROOT / "loose_env/gap/core",
    "doctor": ROOT / "loose_env/doctor",
    "instrument": ROOT / "loose_env/instrument/decide.py",
}
"""Part -> the module of its thresholds, or the folder of such."""
_ENTRY = re.compile(
    r"^(?:# (?P<part>[^\n]+)"
    r"|(?P<name>_?[A-Z][A-Z_0-9]*|    [a-z_]+: \w+) = (?P<value>[^\n#]+?)"
    r'(?:  # (?P<short>[^\n]+)|\n *"""(?P<meaning>.+?)"""))$',
    re.MULTILINE | re.DOTALL,
)


def entries(source: str) -> Iterator[tuple[str, str, str]]:
    """Name, value and meaning of each constant; of a heading of a part, itself alone."""
    for entry in _ENTRY.finditer(source):
        if entry["part"]:
            yield entry["part"], "", ""
        else:
            meaning = " ".join((entry["meaning"] or entry["short"]).split()).rstrip(".")
            meaning = meaning[:1].upper() + meaning[1:]
            yield entry["name"].strip().partition(":")[0], entry["value"], meaning


def threshold_table(source: str) -> str:
    r"""Markdown table of the constants of a module, their docstrings or comments as meaning.

    Examples
    --------
    >>> print(threshold_table('# Search\nLEAST_Z = 3.0\n\"\"\"Smallest z-score.\"\"\"\n'))
    | constant | value | meaning and reason |
    |---|---|---|
    | **Search** | | |
    | `LEAST_Z` | 3.0 | Smallest z-score |
    """
    rows, part = ["| constant | value | meaning and reason |", "|---|---|---|"], ""
    for name, value, meaning in entries(source):
        if not value:
            part = f"| **{name}** | | |"
        else:  # sections without constants have no heading
            rows += [line for line in (part, f"| `{name}` | {value} | {meaning} |") if line]
            part = ""
    return "\n".join(rows)


@dataclass(frozen=True, kw_only=True)
class Options:
    """Part whose thresholds are printed."""

    part: Positional[Annotated[str, one_of(tuple(PARTS))]] = "gap"
    """Part."""


def show(options: Options) -> None:
    """Print the table of a part."""
    place = PARTS[options.part]
    files = sorted(place.glob("*.py")) if place.is_dir() else [place]
    print(threshold_table("".join(f"# {f.stem}\n{f.read_text(encoding='utf-8')}" for f in files)))


if __name__ == "__main__":
    command("threshold_table", __doc__, Options, show)
