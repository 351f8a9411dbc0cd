"""Progress of counted work, shown by tqdm on terminals and in logs."""

from __future__ import annotations

import math
import sys
from typing import TextIO

from tqdm import tqdm

__all__ = ["ProgressLine"]

LINES = 10
"""Lines of a whole run where there is no terminal to write a line over."""


class ProgressLine(tqdm):  # type: ignore[misc]
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
        Name of a unit.
    stream : text file, optional
        Where it is written; standard error if None.

    Examples
    --------
    >>> with ProgressLine(100, stream=sys.stdout) as line:
    ...     line.advance(50, "loss 0.1")
     50%|#####     | 50/100 [00:00<00:00, ... episodes/s, loss 0.1]
    """

    monitor_interval = 0  # no thread that shortens the distance of a log's lines

    def __init__(
        self, total: int, *, done: int = 0, unit: str = "episodes", stream: TextIO | None = None
    ) -> None:
        stream = sys.stderr if stream is None else stream
        over = stream.isatty()
        super().__init__(
            total=total,
            initial=done,
            unit=f" {unit}",
            smoothing=0,  # the rate is that of the whole run
            file=stream if over else _Lines(stream),
            dynamic_ncols=over,
            mininterval=0.1 if over else 0.0,
            miniters=None if over else max(1, math.ceil(total / LINES)),
            delay=0.0 if over else 1e-9,
            leave=over,
        )

    def advance(self, units: int, words: str = "") -> None:
        """Add completed units; the words stand at the end of the line."""
        self.set_postfix_str(words, refresh=False)
        if not self.update(units) and self.n >= self.total:
            self.refresh()  # the last line of a log, where tenths do not divide the work

    def say(self, words: str) -> None:
        """Show how the work on a unit stands."""
        self.set_postfix_str(words)


class _Lines:
    """File that turns the writing over one line into lines."""

    def __init__(self, stream: TextIO) -> None:
        self.stream = stream

    def write(self, text: str) -> None:
        """Write what is left once returns and padding are gone."""
        if line := text.strip("\r\n").rstrip():
            self.stream.write(line + "\n")

    def flush(self) -> None:
        """Flush the stream."""
        self.stream.flush()
