"""Simulations of ours: no warnings, for what fails is told by an error or a record; no timers.

MuJoCo's stopwatch: where the engine keeps what it reads the time by.

Keeps the engine's warnings to ourselves; see `loose_env.arms.engine_warnings`.
"""

from __future__ import annotations

import ctypes
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import mujoco

__all__ = ["STOPWATCH", "quiet"]

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


_LOADED_ALREADY = getattr(os, "RTLD_NOLOAD", 0) | getattr(os, "RTLD_NOW", 0)
"""Mode that opens a library only if the process has loaded it, as the import above does."""


def _found() -> ctypes.c_void_p:
    """Pointer in the engine's library; one that nobody reads where that is out of reach."""
    names = {"win32": "mujoco.dll", "darwin": "libmujoco*.dylib"}
    files = sorted(Path(mujoco.__file__).parent.glob(names.get(sys.platform, "libmujoco.so*")))
    for file in files:
        with suppress(OSError, ValueError):
            library = ctypes.CDLL(str(file), mode=_LOADED_ALREADY)
            return ctypes.c_void_p.in_dll(library, "mjcb_time")
    return ctypes.c_void_p()


STOPWATCH = _found()
"""The engine's pointer to the function that reads the time; set to None, it does not time itself.

It is read at the beginning and the end of every part of every step, for `MjData.timer`: on small
models up to a third of the time of a simulation. No motion depends on it."""
