"""The sections of the reproduction in the order of the page, imported when they are run."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType

from loose_env.errors import UnknownName

__all__ = ["SECTIONS", "choose", "first_line", "load"]

_PACKAGE = "loose_env.thesis"

SECTIONS: dict[str, str] = {
    key: f"{_PACKAGE}.{place}"
    for key, place in {
        "simulations": "ch5_simulation.simulations",
        "correlation_simulations": "ch5_simulation.correlation",
        "modelling": "ch3_modelling.modelling",
        "identification": "ch3_modelling.identification",
        "sizing": "ch6_experiments.arm.sizing",
        "pose_choice": "ch4_diagnosis.pose_choice",
        "signals": "ch6_experiments.slide.experiments_two_three",
        "experiment_one": "ch6_experiments.arm.experiment_one",
        "experiment_four": "ch6_experiments.slide.experiment_four",
        "experiment_five": "ch6_experiments.shaken_vera.experiment_five",
        "experiment_six": "ch6_experiments.shaken_vera.experiment_six",
        "index_tables": "ch4_diagnosis.index_tables",
        "link_finding": "ch4_diagnosis.link_finding",
    }.items()
}
"""Module of each section by its key. A module has ``section(seed) -> Section``."""


def choose(only: Sequence[str] | None = None) -> list[str]:
    """Return the keys asked for, in the order of the page; all of them by default.

    Parameters
    ----------
    only : sequence of str, optional
        Keys of sections.

    Raises
    ------
    UnknownName
        If a key is none of those in `SECTIONS`.

    Examples
    --------
    >>> choose(["link_finding", "sizing"])
    ['sizing', 'link_finding']
    """
    if not only:
        return list(SECTIONS)
    unknown = [key for key in only if key not in SECTIONS]
    if unknown:
        raise UnknownName(
            f"no section {', '.join(map(repr, unknown))}; there are {', '.join(SECTIONS)}"
        )
    return [key for key in SECTIONS if key in only]


def load(key: str) -> ModuleType:
    """Import the module of a section."""
    (key,) = choose([key])
    if find_spec(SECTIONS[key]) is None:
        raise UnknownName(f"section {key!r} has no module {SECTIONS[key]}")
    return import_module(SECTIONS[key])


def first_line(key: str) -> str:
    """Return what the module of a section says it does, or that there is none."""
    try:
        module = load(key)
    except UnknownName:
        return "(no module)"
    return (module.__doc__ or "").strip().partition("\n")[0]
