"""Reproduce the thesis's experiments and compare them with the printed results, on one page.

Usage: python scripts/reproduce_thesis.py --only index_tables vera_link_finding
"""

from __future__ import annotations

import os
import platform
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import loose_env
from loose_env.cli.command import command
from loose_env.io import write_text
from scripts.thesis.page import (
    SECTIONS,
    Outcome,
    choose,
    render_thesis_page,
    run_sections,
    text_of,
)

PACKAGES = ("numpy", "scipy", "mujoco", "gymnasium", "matplotlib", "Jinja2", "odrpack")
TITLE = "A thesis on loose robot joints, reproduced"
TEXT = (
    "A thesis of the 1990s shook a robot arm at random and read from the accelerations where it "
    "was loose, and in which direction. Here its methods are written anew, its rigs are simulated, "
    "and every result stands beside the figure that the thesis printed.",
    "Where a printed figure contradicts the thesis's own data, the table says so and the corrected "
    "equation is used. All figures found here are computed when the page is made.",
)


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Options of the reproduction."""

    out: Path = Path("out/thesis")
    """Folder for the page."""
    seed: int = 1995
    """Seed of every section, 0 or more."""
    only: tuple[str, ...] = ()
    """Run these sections alone."""
    list: bool = False
    """List the sections and stop."""
    workers: int = 2
    """Sections run side by side, 1 or more."""


def versions() -> dict[str, str]:
    """Version of Python and of each package that is installed."""
    found = {"loose-env": loose_env.__version__, "Python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "(not installed)"
    return found


def run(keys: Sequence[str], settings: Settings) -> list[Outcome]:
    """Run the sections; progress and errors go to standard error."""
    found: dict[str, Outcome] = {}
    for o in run_sections(keys, seed=settings.seed, workers=settings.workers):
        found[o.key] = o
        state = f"failed: {o.error}" if o.section is None else "done"
        line = f"{len(found):>3} of {len(keys)}  {o.key:<24}{o.seconds:>7.1f} s  {state}"
        print(line, file=sys.stderr, flush=True)
    for o in found.values():
        if o.trace:
            print(f"\n{o.key}:\n{o.trace}", file=sys.stderr)
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


def reproduce(settings: Settings) -> None:
    """Run, print the summary, write the page; exit with 1 if a section failed."""
    if settings.list:
        for key in SECTIONS:
            print(f"{key:<24}{text_of(key)['about']}")
        return
    begin, keys = time.perf_counter(), choose(settings.only)
    settings.out.mkdir(parents=True, exist_ok=True)  # fails before the run, not after
    outcomes = run(keys, settings)
    only = f" --only {' '.join(keys)}" if settings.only else ""
    html = render_thesis_page(
        outcomes,
        title=TITLE,
        text=TEXT,
        command=f"python scripts/reproduce_thesis.py --seed {settings.seed}{only}",
        seed=settings.seed,
        versions=versions(),
    )
    page = write_text(settings.out / "index.html", html)
    failed = [o.key for o in outcomes if o.section is None]
    print(f"\n{summary(outcomes)}\n")
    if failed:
        print(f"Failed: {', '.join(failed)}")
    print(f"Page: {page}")
    print(f"Took {time.perf_counter() - begin:.0f} s.")
    if failed:
        sys.exit(1)


def main(arguments: Sequence[str] | None = None) -> None:
    """Reproduce, with errors in one line."""
    # Each worker has one core: more threads of BLAS would only stand in each other's way.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    command(
        "reproduce_thesis",
        __doc__,
        Settings,
        reproduce,
        arguments,
        interrupted="nothing was written",
    )


if __name__ == "__main__":
    main()
