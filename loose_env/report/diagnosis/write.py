"""Files of a diagnosis: the pages, then ``result.json``."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from loose_env.errors import InvalidData, MissingExtra
from loose_env.instrument import Diagnosis, Trend, read_recorded_arm
from loose_env.report.diagnosis.page import write_page
from loose_env.report.diagnosis.trend_page import write_trend_page

__all__ = ["write_diagnosis"]


def write_diagnosis(
    folder: Path,
    diagnosis: Diagnosis,
    model: Path,
    *,
    recording: str = "",
    given: str = "",
    trend: Trend | None = None,
    say: Callable[[str], None] = lambda _: None,
) -> list[Path]:
    """Write the pages and ``result.json``, the result last.

    An earlier result never stands beside a later page. What was found is written also where the
    page cannot be drawn.

    Parameters
    ----------
    folder : Path
        Where they go; made where there is none.
    diagnosis : Diagnosis
        Result.
    model : Path
        Model of the recording.
    recording : str
        Name of the recording, for the head of the page.
    given : str
        Its folder as the reader would type it, for commands on the page.
    trend : Trend, optional
        Change since earlier sessions: ``trend.html`` and ``trend.json`` too.
    say : callable
        Receives the reason why there is no page.

    Returns
    -------
    list of Path
        The files written.
    """
    written = []
    result, page = folder / "result.json", folder / "report.html"
    for name in ("result.json", "trend.json", "trend.html"):
        (folder / name).unlink(missing_ok=True)
    try:
        arm = read_recorded_arm(model).shown
        written.append(write_page(page, diagnosis, arm, recording=recording, folder=given))
        if trend is not None:
            written.append(write_trend_page(folder / "trend.html", trend, recording=recording))
    except (MissingExtra, InvalidData) as error:
        page.unlink(missing_ok=True)  # that of an earlier result
        say(f"no report.html: {error}")
    if trend is not None:
        written.append(trend.write(folder / "trend.json"))
    written.append(diagnosis.write(result))  # last: it says that all is there
    return written
