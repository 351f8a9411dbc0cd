"""The report of a comparison of model and measurement, beside its other files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from loose_env.errors import MissingExtra
from loose_env.gap import GapResult, GapSolution, ResidualDiagnostics
from loose_env.report.gap.page import write_gap_page

__all__ = ["write_gap_report"]


def write_gap_report(
    folder: Path,
    solution: GapSolution,
    evidence: ResidualDiagnostics,
    result: GapResult,
    *,
    say: Callable[[str], None] = lambda _: None,
) -> Path | None:
    """Write ``report.html``; None where it cannot be drawn or written.

    A search may have taken hours, and its model and result are worth more than the page: whatever
    it fails by is said, not raised, and an earlier page does not stay.

    Parameters
    ----------
    folder : Path
        Where it goes.
    solution, evidence, result
        As of `loose_env.gap.write_gap`, whose ``report`` this is.
    say : callable
        Receives the reason why there is no page.
    """
    try:
        return write_gap_page(folder / "report.html", solution, evidence, result)
    except MissingExtra as error:
        say(f"no report.html: {error}")
    except Exception as error:  # whatever a page fails by, model and result do not need it
        say(f"no report.html: {type(error).__name__}: {error}")
    folder.joinpath("report.html").unlink(missing_ok=True)
    return None
