"""Write the golden results anew, where a change of them is meant.

Usage: python -m scripts.suites.trust.golden_run --because "what changed, in the words of
CHANGELOG.md"

The words have to stand in CHANGELOG.md, among what is not released yet, and must not have served
for an earlier change: whoever gets other figures from the same seeds is told why. A part whose
figures are as before keeps its words.
"""

from __future__ import annotations

import argparse
import json
import os
import re
from pathlib import Path
from typing import Any

# As the tests have it: the order in which threads of BLAS add up changes the last digits.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from loose_env.cli.command import errors_in_one_line
from loose_env.errors import InvalidSetting
from scripts.suites.trust.golden import GOLDEN, PARTS

CHANGELOG = Path(__file__).resolve().parents[3] / "CHANGELOG.md"


def check_said(because: str, changelog: str) -> None:
    """Refuse words that do not stand under what is not released yet.

    Raises
    ------
    InvalidSetting
        If they do not.
    """
    parts = re.split(r"^(?=## )", changelog, flags=re.MULTILINE)
    new = " ".join(part for part in parts if "unreleased" in part.partition("\n")[0].lower())
    if not because or because not in " ".join(new.split()):
        raise InvalidSetting(
            f"CHANGELOG.md does not say {because!r} under what is unreleased; put it there first, "
            "for those whose figures change"
        )


def renewed(name: str, kept: dict[str, Any] | None, found: Any, because: str) -> dict[str, Any]:
    """A part as it is kept from now on.

    Raises
    ------
    InvalidSetting
        If its figures change, and the words are those of its last change.
    """
    if kept is None:
        return {"because": because, "found": found}
    if kept["found"] == found:
        return kept
    if " ".join(kept["because"].split()) == because:
        raise InvalidSetting(
            f"{name}: {because!r} was the reason of an earlier change; give CHANGELOG.md a line on "
            "this one"
        )
    return {"because": because, "found": found}


def main() -> None:
    """Read the options and write the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--because", required=True, help="words of the line in CHANGELOG.md")
    parser.add_argument("--only", nargs="+", choices=list(PARTS), help="parts; all by default")
    options = parser.parse_args()
    with errors_in_one_line("trust_golden"):
        because = " ".join(options.because.split())
        check_said(because, CHANGELOG.read_text(encoding="utf-8"))
        whole = json.loads(GOLDEN.read_text(encoding="utf-8")) if GOLDEN.is_file() else {}
        for name in options.only or PARTS:
            made = json.loads(json.dumps(PARTS[name]()))  # type: ignore[operator]
            whole[name] = renewed(name, whole.get(name), made, because)
            print(f"{name}: done", flush=True)
        beside = GOLDEN.with_suffix(".part")
        text = json.dumps(whole, indent=None, separators=(",", ":"), sort_keys=True)
        beside.write_text(text.replace('"found":', '\n"found":') + "\n", encoding="utf-8")
        beside.replace(GOLDEN)


if __name__ == "__main__":
    main()
