"""Files of a diagnosis: the page, then ``result.json``."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from loose_env.errors import InvalidData, MissingExtra
from loose_env.instrument import Diagnosis, read_recorded_arm
from loose_env.report.diagnosis.page import write_page

__all__ = ["write_diagnosis"]


def write_diagnosis(
    folder: Path,
    diagnosis: Diagnosis,
    model: Path,
    *,
    recording: str = "",
    say: Callable[[str], None] = lambda _: None,
) -> list[Path]:
    """Write ``report.html`` and ``result.json``, the result last.

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
    say : callable
        Receives the reason why there is no page.

    Returns
    -------
    list of Path
        The files written.
    """
    written = []
    result, page = folder / "result.json", folder / "report.html"
    result.unlink(missing_ok=True)
    try:
        arm = read_recorded_arm(model).shown
        written.append(write_page(page, diagnosis, arm, recording=recording))
    except (MissingExtra, InvalidData) as error:
        page.unlink(missing_ok=True)  # that of an earlier result
        say(f"no report.html: {error}")
    written.append(diagnosis.write(result))  # last: it says that all is there
    return written
