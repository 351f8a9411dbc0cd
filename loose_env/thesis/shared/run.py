"""Run sections side by side; an error in one of them leaves the others whole."""

from __future__ import annotations

import time
import traceback
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from multiprocessing import get_context

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.report import Plate, to_svg
from loose_env.thesis.shared.registry import choose, load
from loose_env.thesis.shared.section import Section

__all__ = ["Outcome", "run_section", "run_sections"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Outcome:
    """What became of a section: the section itself, or why there is none."""

    key: str
    """Key of the section."""
    seconds: float
    """How long it ran [s]."""
    section: Section | None = None
    """The section, its figures as SVG; None where it failed."""
    error: str = ""
    """The error in one line."""
    trace: str = ""
    """Where it happened, for the terminal."""


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
        section = replace(found, plates=[_drawn(plate) for plate in found.plates])
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


def _drawn(plate: Plate) -> Plate:
    return plate if isinstance(plate.image, bytes) else replace(plate, image=to_svg(plate.image))
