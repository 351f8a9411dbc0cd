"""A process that reads damaged files, so that what kills it kills nothing else."""

from __future__ import annotations

import argparse
import faulthandler
import json
import os
import resource
import sys
import tempfile
from pathlib import Path

from scripts.suites.trust.fuzz.cases import attempt
from scripts.suites.trust.fuzz.surroundings import Surroundings
from scripts.suites.trust.fuzz.watch import Watch, judged, snapshot

MEMORY = 8 * 2**30
"""Address space of the process [bytes]: who asks for more is refused it."""


def main() -> None:
    """Read the attempts that stand on the command line; say what came of each, a line each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kind")
    parser.add_argument("start", type=int)
    parser.add_argument("stop", type=int)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    faulthandler.disable()
    watch = Watch()
    watch.install()
    with tempfile.TemporaryDirectory(prefix="trust-") as place:
        around = Surroundings(Path(place))
        os.chdir(around.cwd)
        watch.secret = around.secret
        for number in range(options.start, options.stop):
            print(json.dumps({"number": number, "begun": True}), flush=True)
            made = attempt(options.kind, number, around, options.seed)
            verdict = judged(made, watch, lambda: snapshot(around.root))
            line = {"number": number, "damage": made.damage} | vars(verdict)
            print(json.dumps(line), flush=True)
        os.chdir("/")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
