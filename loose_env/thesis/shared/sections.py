"""Sections of the reproduction: contents, registry, and runs in parallel processes."""

from __future__ import annotations

import time
import traceback
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field, replace
from importlib import import_module
from importlib.util import find_spec
from multiprocessing import get_context
from types import ModuleType

from loose_env.errors import InvalidData, InvalidSetting, UnknownName
from loose_env.report import FigureCard, to_svg


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table of the page; every cell is formatted text."""

    caption: str
    """Caption, with the number of the thesis's table or section."""
    columns: tuple[str, ...]
    """Headings; the first column names the row."""
    rows: tuple[tuple[str, ...], ...]
    """Cells, as many in a row as there are columns."""

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.columns):
                raise InvalidData(
                    f"table {self.caption!r} has {len(self.columns)} columns, got the row {row}"
                )


@dataclass(frozen=True, kw_only=True, eq=False)
class Section:
    """One experiment or method of the thesis, reproduced."""

    key: str
    """Short name, also the anchor on the page."""
    title: str
    """Heading, with the thesis's section or experiment."""
    finding: str
    """The outcome in one sentence, printed beside found: for the table at the top of the page."""
    words: Sequence[str]
    """Paragraphs: method, result of the thesis, result here."""
    tables: Sequence[Table] = ()
    """Tables, printed beside found."""
    cards: Sequence[FigureCard] = ()
    """Figures."""
    equations: Mapping[str, str] = field(default_factory=dict)
    """Function that implements each equation, by its number: ``{"6.6": "module.function"}``."""
    left_out: Sequence[str] = ()
    """Parts of the thesis that are not reproduced, and the reasons."""


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
        "vera_link_finding": "ch4_diagnosis.vera_link_finding",
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
    """First line of the docstring of a section's module."""
    try:
        module = load(key)
    except UnknownName:
        return "(no module)"
    return (module.__doc__ or "").strip().partition("\n")[0]


@dataclass(frozen=True, kw_only=True, eq=False)
class Outcome:
    """Outcome of a run: the section, or the error."""

    key: str
    """Key of the section."""
    seconds: float
    """Run time [s]."""
    section: Section | None = None
    """The section, its figures as SVG; None where it failed."""
    error: str = ""
    """The error in one line."""
    trace: str = ""
    """Traceback, for the terminal."""


def run_section(key: str, seed: int) -> Outcome:
    """Run one section; whatever it raises comes back as its outcome."""
    begin = time.perf_counter()
    try:
        found = load(key).section(seed)
        if not isinstance(found, Section):
            raise InvalidData(f"section {key!r} returned a {type(found).__name__}, no Section")
        if found.key != key:
            raise InvalidData(f"section {key!r} calls itself {found.key!r}")
        # Figures become SVG here, so that the work is shared and little travels back.
        section = replace(found, cards=[_drawn(card) for card in found.cards])
    except (Exception, SystemExit) as error:
        return _failed(key, error, time.perf_counter() - begin)
    return Outcome(key=key, seconds=time.perf_counter() - begin, section=section)


def run_sections(keys: Sequence[str], *, seed: int, workers: int = 2) -> Iterator[Outcome]:
    """Run sections in processes of their own and yield each outcome as it is done.

    A section depends on the seed alone, so the outcomes are the same for any number of workers;
    only their order changes. A section whose process dies is reported as failed.

    Parameters
    ----------
    keys : sequence of str
        Sections, started in this order.
    seed : int
        Given to each of them, 0 or more.
    workers : int
        Processes side by side, 1 or more.

    Yields
    ------
    Outcome
        One a section.

    Raises
    ------
    InvalidSetting
        If the seed is negative or there is no worker.
    UnknownName
        If a key is unknown.
    """
    if workers < 1:
        raise InvalidSetting(f"workers is {workers}; there must be 1 or more")
    if seed < 0:
        raise InvalidSetting(f"seed is {seed}; it must be 0 or more")
    if not keys:
        return
    choose(keys)
    lost: list[str] = []
    for key, outcome in _pool(keys, seed, workers):
        if outcome is None:
            lost.append(key)
        else:
            yield outcome
    # A process that dies takes down all that share its pool: those run again, each alone.
    for key in sorted(lost, key=list(keys).index):
        begin = time.perf_counter()
        for _, outcome in _pool([key], seed, 1):
            spent = time.perf_counter() - begin
            yield outcome or Outcome(key=key, seconds=spent, error="its process died")


def _pool(keys: Sequence[str], seed: int, workers: int) -> Iterator[tuple[str, Outcome | None]]:
    """Yield each key with its outcome, or None where the pool broke before."""
    # Spawned, not forked: a fork would inherit the threads' locks of MuJoCo and BLAS.
    with ProcessPoolExecutor(min(workers, len(keys)), mp_context=get_context("spawn")) as pool:
        futures: dict[Future[Outcome], str] = {}
        early: list[str] = []
        for key in keys:
            try:
                futures[pool.submit(run_section, key, seed)] = key
            except BrokenProcessPool:
                early.append(key)
        try:
            for future in as_completed(futures):
                try:
                    yield futures[future], future.result()
                except BrokenProcessPool:
                    yield futures[future], None
                except Exception as error:  # the section ran, but could not be sent back
                    yield futures[future], _failed(futures[future], error, 0.0)
            yield from ((key, None) for key in early)
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _failed(key: str, error: BaseException, seconds: float) -> Outcome:
    line = " ".join(f"{type(error).__name__}: {error}".split())
    trace = "".join(traceback.format_exception(error))
    return Outcome(key=key, seconds=seconds, error=line, trace=trace)


def _drawn(card: FigureCard) -> FigureCard:
    return card if isinstance(card.image, bytes) else replace(card, image=to_svg(card.image))
