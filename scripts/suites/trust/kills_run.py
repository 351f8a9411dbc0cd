"""Kill training, comparison, gap and diagnosis at 20 random moments each, and see that they go on.

Each command is run once without being stopped. Then it is killed (SIGKILL, with all its
processes) after a random number of changes in its folder, of all that it makes, and run again in
the same folder, over and over. After every kill all files of its folder have to be whole. In the
end comparison, gap and diagnosis have to write what the run wrote that was not stopped; a training
that was resumed has met other faults, so of it the steps, the evaluations and the files are
compared.

Usage: python -m scripts.suites.trust.kills_run [--kills 20] [--only training comparison gap
diagnosis]
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
from dataclasses import asdict
from pathlib import Path

import numpy as np

from loose_env.cli.command import errors_in_one_line
from scripts.suites.trust.kills.commands import commands
from scripts.suites.trust.kills.killing import ROOT, kill_often


def main() -> None:
    """Read the options, kill, and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kills", type=int, default=20, help="of each command")
    parser.add_argument("--only", nargs="+", help="commands; all by default")
    parser.add_argument("--seed", type=int, default=1, help="of the moments")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "trust")
    options = parser.parse_args()
    with errors_in_one_line("trust_kills"):
        options.out.mkdir(parents=True, exist_ok=True)
        known = commands(options.out / "kills")
        lines = [
            "| command | kills | after a write | runs to the end | same result | problems |",
            "|---|---:|---:|---:|---:|---:|",
        ]
        bad = []
        for number, name in enumerate(options.only or known):
            place = options.out / "kills" / name
            shutil.rmtree(place, ignore_errors=True)
            sequence = np.random.SeedSequence(options.seed, spawn_key=(number,))
            found = kill_often(
                known[name],
                place,
                kills=options.kills,
                rng=np.random.default_rng(sequence),
                say=lambda words: print(words, file=sys.stderr, flush=True),
            )
            options.out.joinpath(f"kills-{name}.json").write_text(json.dumps(asdict(found)))
            lines.append(
                f"| {name} | {found.kills} | {found.after_write} | {found.runs} | {found.equal} "
                f"| {len(found.problems)} |"
            )
            bad += [f"{name}: {problem}" for problem in found.problems]
        print("\n".join([*lines, *bad]))
    if bad:
        sys.exit(1)


if __name__ == "__main__":
    main()
