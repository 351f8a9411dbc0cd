"""Single-line progress display with rate and remaining time."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import TextIO

__all__ = ["ProgressLine"]

SHORTEST_TIME = 0.1  # [s] between two writings on a terminal
STEPS = 10  # lines in all where there is no terminal to write a line over


class ProgressLine:
    """Progress of work that is counted in equal units.

    On a terminal one line is written over and over; elsewhere, as in a log, a line appears for
    about every tenth of the work.

    Parameters
    ----------
    total : int
        Units in all.
    done : int
        Units that an earlier run has done; they count for the share, not for the rate.
    unit : str
        What a unit is called.
    stream : text file, optional
        Where it is written; standard error if None.
    clock : callable
        Time now [s].

    Examples
    --------
    >>> times = iter([0.0, 10.0])
    >>> with ProgressLine(100, stream=sys.stdout, clock=lambda: next(times)) as line:
    ...     line.advance(50)
      50/100 episodes   50 %  5.0/s  10 s left
    """

    def __init__(
        self,
        total: int,
        *,
        done: int = 0,
        unit: str = "episodes",
        stream: TextIO | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._total, self._done, self._before, self._unit = total, done, done, unit
        self._stream = sys.stderr if stream is None else stream
        self._over = self._stream.isatty()
        self._clock = clock
        self._begin = clock()
        self._last = -float("inf")
        self._step = done * STEPS // max(total, 1)
        self._width = 0

    def __enter__(self) -> ProgressLine:
        """Start the display."""
        return self

    def __exit__(self, *reason: object) -> None:
        """End the line, also after an exception."""
        if self._width:
            self._stream.write("\n")
            self._stream.flush()

    def advance(self, units: int, words: str = "") -> None:
        """Add completed units and refresh the display when due.

        Parameters
        ----------
        units : int
            How many.
        words : str
            How the work stands, written at the end of the line.
        """
        self._done += units
        now = self._clock()
        whole = self._done >= self._total
        if self._over:
            if not whole and now - self._last < SHORTEST_TIME:
                return
        else:
            step = self._done * STEPS // max(self._total, 1)
            if step == self._step:
                return
            self._step = step
        self._last = now
        self._write("  ".join(filter(None, (self._words(now - self._begin), words))))

    def _words(self, spent: float) -> str:
        share = self._done / self._total
        rate = (self._done - self._before) / max(spent, 1e-9)
        number = f"{self._done:{len(str(self._total)) + 1}d}/{self._total} {self._unit}"
        left = (self._total - self._done) / rate if rate > 0.0 else float("inf")
        return f" {number}  {100.0 * share:3.0f} %  {_rate(rate)}  {_duration(left)} left"

    def _write(self, words: str) -> None:
        if self._over:
            self._stream.write("\r" + words.ljust(self._width))
            self._width = len(words)
        else:
            self._stream.write(words + "\n")
        self._stream.flush()


def _rate(rate: float) -> str:
    """Format a rate per second, or per minute or hour if below one."""
    for name, seconds in (("s", 1.0), ("min", 60.0)):
        if rate * seconds >= 1.0:
            return f"{rate * seconds:.1f}/{name}"
    return f"{rate * 3600.0:.1f}/h"


def _duration(seconds: float) -> str:
    """Format a duration in its two largest units."""
    if seconds == float("inf"):
        return "unknown time"
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"
