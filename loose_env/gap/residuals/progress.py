"""Progress lines of long computations: count of items done, and time left.

Whoever has something to count wraps it in `counted`; whoever computes calls `tick` now and then.
A line is printed only where nothing has been for a few seconds, so that short runs stay short.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import TypeVar

Say = Callable[[str], None]
_Item = TypeVar("_Item")

_SILENT = 6.0
"""How long nothing is printed before a line of progress [s]: none waits for ten seconds."""


@dataclass(eq=False)
class _Count:
    """Something that is counted."""

    title: str
    total: int
    begun: float
    most: bool = False
    done: int = 0

    def description(self, now: float) -> str:
        """The count, and the time left once there is something to judge it by."""
        line = f"{self.title}: {self.done} of {'at most ' * self.most}{self.total}"
        if self.most or not self.done:
            return line
        left = (now - self.begun) / self.done * (self.total - self.done)
        return f"{line}, about {left:.0f} s left" if left >= 1 else line


@dataclass(eq=False)
class _Reporter:
    """Prints lines, and knows when the last one was."""

    say: Say
    clock: Callable[[], float]
    last: float
    counts: list[_Count] = field(default_factory=list)

    def line(self, words: str) -> None:
        """Print a line."""
        self.last = self.clock()
        self.say(words)

    def tick(self) -> None:
        """Print what is counted where nothing has been printed for long."""
        now = self.clock()
        if now - self.last >= _SILENT and self.counts:
            self.line("  " + "; ".join(count.description(now) for count in self.counts))


_REPORTER: ContextVar[_Reporter | None] = ContextVar("progress", default=None)


@contextmanager
def reported(say: Say, *, clock: Callable[[], float] = time.monotonic) -> Iterator[Say]:
    """Give the lines of progress within to a function; yields one for all other lines.

    Examples
    --------
    >>> now = iter(range(0, 100, 4))
    >>> with reported(print, clock=lambda: float(next(now))):
    ...     for _ in counted("screening", "abc"):
    ...         tick()
      screening: 0 of 3
      screening: 2 of 3, about 8 s left
    """
    reporter = _Reporter(say, clock, clock())
    token = _REPORTER.set(reporter)
    try:
        yield reporter.line
    finally:
        _REPORTER.reset(token)


def counted(title: str, items: Sequence[_Item], *, most: bool = False) -> Iterator[_Item]:
    """Iterate over some items, counted for the lines of progress."""
    reporter = _REPORTER.get()
    if reporter is None:
        yield from items
        return
    count = _Count(title, len(items), reporter.clock(), most)
    reporter.counts.append(count)
    try:
        for item in items:
            yield item
            count.done += 1
    finally:
        reporter.counts.remove(count)


def tick() -> None:
    """Print a line of progress where nothing has been printed for some seconds."""
    reporter = _REPORTER.get()
    if reporter is not None:
        reporter.tick()
