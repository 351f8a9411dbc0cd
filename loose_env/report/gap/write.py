"""All that a comparison of model and measurement writes into its folder."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from loose_env.errors import MissingExtra
from loose_env.gap import GapOutputs, GapResult, gather, result_of, write_model_and_result
from loose_env.report.gap.page import write_gap_page

__all__ = ["write_outputs"]


def write_outputs(
    folder: str | Path, outputs: GapOutputs, *, say: Callable[[str], None] = lambda _: None
) -> tuple[GapResult, list[Path]]:
    """Write ``model.xml``, ``report.html`` and ``result.json``, each whole, the result last.

    Without jinja2 and matplotlib the page is left out, and so it is where it cannot be drawn or
    written: a search may have taken hours, and its model and result are worth more.

    Parameters
    ----------
    folder : str or Path
        Where they go; made where there is none.
    outputs : GapOutputs
        The finished comparison.
    say : callable
        Told what goes on, line by line.

    Returns
    -------
    tuple
        The result, and the files written.

    Raises
    ------
    InvalidData
        If the corrected model does not compile.
    """
    place = Path(folder)
    evidence = gather(outputs, say=say)
    result = result_of(outputs, evidence)
    # An earlier result must not stand beside a later model if this run is cut short.
    place.joinpath("result.json").unlink(missing_ok=True)
    say("writing the model, the result and the page")
    pages = []
    try:
        pages.append(write_gap_page(place / "report.html", outputs, evidence, result))
    except MissingExtra as error:
        say(f"no report.html: {error}")
    except Exception as error:  # whatever a page fails by, model and result do not need it
        say(f"no report.html: {type(error).__name__}: {error}")
    if not pages:  # nor must an earlier page
        place.joinpath("report.html").unlink(missing_ok=True)
    *models, file = write_model_and_result(place, outputs, result)
    return result, [*models, *pages, file]
