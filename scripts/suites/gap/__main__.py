"""Make blind recordings.

Usage: python -m scripts.suites.gap --out FOLDER [--quick] [--numbers 1004 2001]
Recordings go to FOLDER/recordings, what is true of them to FOLDER/truth. Cases that are there
already are left alone.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from scripts.suites.gap.cases.cases import full_list, name_of, quick_list
from scripts.suites.gap.cases.draw import draw_case
from scripts.suites.gap.cases.recordings import is_written, write_case


def main() -> None:
    """Write the cases that are missing."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--numbers", type=int, nargs="*")
    parser.add_argument("--show", action="store_true", help="print what is true")
    options = parser.parse_args()
    numbers = options.numbers or (quick_list() if options.quick else full_list())
    recordings, truth = options.out / "recordings", options.out / "truth"
    for number in numbers:
        name = name_of(number)
        if is_written(number, name, recordings=recordings, truth=truth):
            continue
        began = time.perf_counter()
        case = draw_case(number)
        drawn = time.perf_counter()
        write_case(case, recordings=recordings, truth=truth)
        line = (
            f"{name}  drawn in {drawn - began:.1f} s, made in {time.perf_counter() - drawn:.1f} s"
        )
        if options.show:
            line += f"  {number} {case.form} {case.arm.figures.name}"
            for effect, size in zip(case.arm.effects, case.sizes, strict=True):
                line += (
                    f"  {effect.kind}@{effect.place.name} {size['ratio']:.1f}x {size['size']:.3g}"
                )
        print(line, flush=True)


if __name__ == "__main__":
    main()
