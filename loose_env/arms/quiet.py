"""Keeps the engine's warnings to ourselves: what fails is reported by an error or a record."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import mujoco

__all__ = ["quiet"]

_log_lock = threading.Lock()
_log_before: list[mujoco.MjLogConfig] = []  # one entry for every call inside `quiet`


@contextmanager
def quiet() -> Iterator[None]:
    """Keep MuJoCo's warnings off the console and out of its log file.

    A diverging simulation is reported through its measurement. The setting belongs to the
    whole process: the first call in saves it, the last one out puts it back.
    """
    with _log_lock:
        _log_before.append(mujoco.MjLogConfig.get())
        silent = mujoco.MjLogConfig.get()
        silent.logto_console = silent.logto_file = False
        silent.set()
    try:
        yield
    finally:
        with _log_lock:
            last = _log_before.pop()
            if not _log_before:
                last.set()
