"""One-line error messages for scripts."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

import gymnasium

from loose_env.errors import LooseEnvError, words_of

__all__ = ["errors_in_one_line"]


@contextmanager
def errors_in_one_line(script: str, *, interrupted: str = "") -> Iterator[None]:
    """End the script with a one-line message on invalid input or an interrupt.

    Any other error is a fault of the program and keeps its trace.

    Parameters
    ----------
    script : str
        Name that the line begins with.
    interrupted : str
        What follows after Ctrl-C, such as how the work goes on.

    Raises
    ------
    SystemExit
        With the line.

    Examples
    --------
    >>> with errors_in_one_line("train"):
    ...     raise LooseEnvError("there is no arm 'vero'")
    Traceback (most recent call last):
        ...
    SystemExit: train: there is no arm 'vero'
    """
    try:
        yield
    except KeyboardInterrupt:
        sys.exit(f"{script}: interrupted" + (f"; {interrupted}" if interrupted else ""))
    except (LooseEnvError, gymnasium.error.Error, ImportError, ValueError, OSError) as error:
        sys.exit(f"{script}: {words_of(error)}")
