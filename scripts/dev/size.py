"""Print the lines of Python of each part of the repository beside its budget.

Usage: python scripts/dev/size.py [--json FILE]. The budgets are the table under "Budgets" of
CONTRIBUTING.md; lines are counted with docstrings and comments, as `wc -l` does.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
ROW = re.compile(
    r"^\| (?P<name>[^|]+?) \| (?P<places>[^|]+?) \| (?P<budget>[\d,]+) \|$", re.MULTILINE
)
SECTION = re.compile(r"^## Budgets$(?P<body>.*?)(?=^## |\Z)", re.MULTILINE | re.DOTALL)
WORDS = "words"
"""Unit of a row of pages; every other row counts lines of Python."""


@dataclass(frozen=True, kw_only=True)
class Part:
    """Size of a part beside its budget."""

    name: str
    files: int
    size: int
    """Lines of Python, or words of pages."""
    budget: int

    @property
    def over(self) -> int:
        """Amount over the budget; 0 within it."""
        return max(0, self.size - self.budget)


def files_of(place: str, root: Path) -> list[Path]:
    """Files of a place: a folder's Python files, or what a glob pattern matches."""
    path = root / place
    return sorted(path.rglob("*.py") if path.is_dir() else root.glob(place))


def measured(contributing: str, root: Path = ROOT) -> list[Part]:
    """Size of every part that the table of budgets names."""
    section = SECTION.search(contributing)
    rows = list(ROW.finditer(section["body"])) if section else []
    if not rows:
        raise ValueError("CONTRIBUTING.md has no table of budgets under '## Budgets'")
    parts = []
    for row in rows:
        places = [place.strip("` ") for place in row["places"].split(",")]
        found = {place: files_of(place, root) for place in places}
        if missing := [place for place, files in found.items() if not files]:
            raise ValueError(f"budget of {row['name']}: no file in {', '.join(missing)}")
        files = sorted({file for each in found.values() for file in each})
        texts = [file.read_text(encoding="utf-8") for file in files]
        pages = WORDS in row["name"]
        size = sum(len(text.split()) if pages else text.count("\n") for text in texts)
        budget = int(row["budget"].replace(",", ""))
        parts.append(Part(name=row["name"], files=len(files), size=size, budget=budget))
    return parts


def table(parts: list[Part]) -> str:
    """Text of the sizes, one line a part."""
    lines = [f"{'part':<44}{'files':>6}{'size':>9}{'budget':>9}{'over':>8}"]
    lines += [
        f"{each.name:<44}{each.files:>6}{each.size:>9,}{each.budget:>9,}"
        f"{f'{each.over:,}' if each.over else '':>8}"
        for each in parts
    ]
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the table as JSON")
    options = parser.parse_args(arguments)
    try:
        parts = measured((ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"))
    except ValueError as error:
        sys.exit(f"size: {error}")
    print(table(parts))
    if options.json:
        options.json.write_text(json.dumps([asdict(each) for each in parts], indent=1) + "\n")


if __name__ == "__main__":
    main()
