"""Write the golden results anew, where a change of them is meant.

Usage: python -m scripts.trust_golden --because "what changed, in the words of CHANGELOG.md"

The words have to stand in CHANGELOG.md: whoever gets other figures from the same seeds is told why.
"""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path

# As the tests have it: the order in which threads of BLAS add up changes the last digits.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from agents.one_line_errors import errors_in_one_line
from loose_env.errors import InvalidSetting
from scripts.trust.golden import GOLDEN, PARTS

CHANGELOG = Path(__file__).resolve().parents[1] / "CHANGELOG.md"


def main() -> None:
    """Read the options and write the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--because", required=True, help="words of the line in CHANGELOG.md")
    parser.add_argument("--only", nargs="+", choices=list(PARTS), help="parts; all by default")
    options = parser.parse_args()
    with errors_in_one_line("trust_golden"):
        said = " ".join(CHANGELOG.read_text(encoding="utf-8").split())
        if not options.because.strip() or " ".join(options.because.split()) not in said:
            raise InvalidSetting(
                f"CHANGELOG.md does not say {options.because!r}; put it there first, for those "
                "whose figures change"
            )
        whole = json.loads(GOLDEN.read_text(encoding="utf-8")) if GOLDEN.is_file() else {}
        for name in options.only or PARTS:
            whole[name] = {"because": options.because, "found": PARTS[name]()}
            print(f"{name}: done", flush=True)
        beside = GOLDEN.with_suffix(".part")
        text = json.dumps(whole, indent=None, separators=(",", ":"), sort_keys=True)
        beside.write_text(text.replace('"found":', '\n"found":') + "\n", encoding="utf-8")
        beside.replace(GOLDEN)


if __name__ == "__main__":
    main()
