"""Reproduce the thesis's experiments and compare them with the printed results, on one page.

Usage: python scripts/reproduce_thesis.py --only index_tables link_finding
"""

from __future__ import annotations

import argparse
import os
import platform
import sys
import time
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import loose_env
from loose_env.errors import LooseEnvError, words_of
from loose_env.io import write_text
from loose_env.thesis import SECTIONS, Outcome, choose, first_line, render_thesis_page, run_sections

SEED = 1995
PACKAGES = ("numpy", "scipy", "mujoco", "gymnasium", "matplotlib", "Jinja2", "odrpack")

_TITLE = "A thesis on loose robot joints, reproduced"
_TEXT = (
    "A thesis of the 1990s shook a robot arm at random and read from the accelerations where it "
    "was loose, and in which direction. Here its methods are written anew, its rigs are simulated, "
    "and every result stands beside the figure that the thesis printed.",
    "Where a printed figure contradicts the thesis's own data, the table says so and the corrected "
    "equation is used. All figures found here are computed when the page is made.",
)


def parser() -> argparse.ArgumentParser:
    """Options of the reproduction."""
    options = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    options.add_argument("--out", default="out/thesis", help="folder for the page")
    options.add_argument("--seed", type=int, default=SEED, help="seed of every section")
    options.add_argument("--only", nargs="+", metavar="KEY", help="run these sections alone")
    options.add_argument("--list", action="store_true", help="list the sections and stop")
    options.add_argument("--workers", type=int, default=2, help="sections run side by side")
    return options


def versions() -> dict[str, str]:
    """Version of Python and of each package that is installed."""
    found = {"loose-env": loose_env.__version__, "Python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "(not installed)"
    return found


def command_of(options: argparse.Namespace) -> str:
    """Return the command that makes the same page."""
    words = ["python scripts/reproduce_thesis.py", f"--seed {options.seed}"]
    if options.only:
        words.append("--only " + " ".join(choose(options.only)))
    return " ".join(words)


def run(keys: Sequence[str], *, seed: int, workers: int) -> list[Outcome]:
    """Run the sections; progress and errors go to standard error."""
    found: dict[str, Outcome] = {}
    for outcome in run_sections(keys, seed=seed, workers=workers):
        found[outcome.key] = outcome
        state = f"failed: {outcome.error}" if outcome.section is None else "done"
        line = (
            f"{len(found):>3} of {len(keys)}  {outcome.key:<24}{outcome.seconds:>7.1f} s  {state}"
        )
        print(line, file=sys.stderr, flush=True)
    return [found[key] for key in keys]


def summary(outcomes: Sequence[Outcome]) -> str:
    """Lay the outcomes out for a terminal."""
    head = f"{'section':<24}{'equations':>10}{'tables':>8}{'figures':>9}{'seconds':>9}"
    lines = [head, "-" * len(head)]
    for o in outcomes:
        counts = f"{'failed':>27}"
        if o.section is not None:
            s = o.section
            counts = f"{len(s.equations):>10}{len(s.tables):>8}{len(s.cards):>9}"
        lines.append(f"{o.key:<24}{counts}{o.seconds:>9.1f}")
    return "\n".join(lines)


def reproduce(options: argparse.Namespace) -> int:
    """Run, print the summary, write the page; return the exit status."""
    if options.list:
        for key in SECTIONS:
            print(f"{key:<24}{first_line(key)}")
        return 0
    begin = time.perf_counter()
    keys = choose(options.only)
    out = Path(options.out)
    out.mkdir(parents=True, exist_ok=True)  # fails before the run, not after
    outcomes = run(keys, seed=options.seed, workers=options.workers)
    for o in outcomes:
        if o.trace:
            print(f"\n{o.key}:\n{o.trace}", file=sys.stderr)
    html = render_thesis_page(
        outcomes,
        title=_TITLE,
        text=_TEXT,
        command=command_of(options),
        seed=options.seed,
        versions=versions(),
    )
    page = write_text(out / "index.html", html)
    failed = [o.key for o in outcomes if o.section is None]
    print(f"\n{summary(outcomes)}\n")
    if failed:
        print(f"Failed: {', '.join(failed)}")
    print(f"Page: {page}")
    print(f"Took {time.perf_counter() - begin:.0f} s.")
    return 1 if failed else 0


def main(arguments: Sequence[str] | None = None) -> None:
    """Reproduce, with errors in one line."""
    # Each worker has one core: more threads of BLAS would only stand in each other's way.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    options = parser().parse_args(arguments)
    try:
        status = reproduce(options)
    except KeyboardInterrupt:
        sys.exit("reproduce_thesis: interrupted; nothing was written")
    except (LooseEnvError, OSError) as error:
        sys.exit(f"reproduce_thesis: {words_of(error)}")
    sys.exit(status)


if __name__ == "__main__":
    main()
