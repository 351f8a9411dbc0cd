"""Simulations of ours: no warnings, for what fails is told by an error or a record; no timers."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import mujoco

from loose_env.arms.stopwatch import STOPWATCH

__all__ = ["quiet"]

_lock = threading.Lock()
_before: list[tuple[mujoco.MjLogConfig, int | None]] = []  # one for every call inside `quiet`


@contextmanager
def quiet() -> Iterator[None]:
    """Keep MuJoCo's warnings off the console and out of its log file, and its stopwatch still.

    A diverging simulation is reported through its measurement. Both settings belong to the
    whole process: the first call in saves them, the last one out puts them back.
    """
    with _lock:
        _before.append((mujoco.MjLogConfig.get(), STOPWATCH.value))
        silent = mujoco.MjLogConfig.get()
        silent.logto_console = silent.logto_file = False
        silent.set()
        STOPWATCH.value = None
    try:
        yield
    finally:
        with _lock:
            log, clock = _before.pop()
            if not _before:
                log.set()
                STOPWATCH.value = clock
