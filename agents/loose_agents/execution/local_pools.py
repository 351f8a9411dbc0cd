"""Pools of workers: what each backend does to run a call and to notice that its worker died.

joblib's own front (``Parallel``) fails as a whole when a worker dies and does not say which call
it was running. The pools here therefore speak to each backend's executor: loky's, as joblib
ships it, and those of Ray, Dask and submitit.
"""

from __future__ import annotations

import concurrent.futures
import importlib
import os
import pickle
import signal
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any, Protocol

from loose_agents.execution.backends import BackendSettings
from loose_env.errors import MissingExtra

__all__ = [
    "ONE_THREAD",
    "LokyPool",
    "Pool",
    "Raised",
    "ThreadPool",
    "WorkerDied",
    "cores",
    "guarded",
    "load_extra",
]

ONE_THREAD = dict.fromkeys(
    (
        "BLIS_NUM_THREADS",
        "MKL_NUM_THREADS",
        "NUMBA_NUM_THREADS",
        "NUMEXPR_NUM_THREADS",
        "OMP_NUM_THREADS",
        "OPENBLAS_NUM_THREADS",
        "VECLIB_MAXIMUM_THREADS",
    ),
    "1",
)
"""Environment of a worker. One thread even where there is one worker: the order in which threads
add up changes the last digit, and rows must not depend on the number of workers."""

ORPHAN_CHECK = 1.0  # [s] between a worker's looks whether its parent still lives


class WorkerDied(Exception):
    """The process that ran a call is gone, by a signal, for want of memory or by its own exit."""


@dataclass(frozen=True, kw_only=True)
class Raised:
    """What a call raised, in a form that every backend carries back alike."""

    error: BaseException | None
    """The exception; None where it cannot be pickled."""
    summary: str
    """Its kind and its words, in one line."""
    trace: str
    """Where it happened."""


class Pool(Protocol):
    """Workers that run one call each. A ticket stands for a call that was begun."""

    size: int
    """Calls that run side by side."""

    def submit(self, work: Callable[[Any], Any], shard: Any) -> Any:
        """Begin a call of `guarded`, on a worker that is free, and return its ticket."""

    def wait(self, tickets: Sequence[Any]) -> Sequence[Any]:
        """Wait until one of these calls or more is over; return the tickets of those."""

    def result(self, ticket: Any) -> Any:
        """Result of a call that is over; raise `WorkerDied` where its worker did."""

    def close(self) -> None:
        """Stop what still runs and end what the pool has started."""


def guarded(work: Callable[[Any], Any], shard: Any) -> Any:
    """Call the work in a worker; what it raises comes back as `Raised`."""
    try:
        return work(shard)
    except (Exception, SystemExit) as error:
        return Raised(
            error=error if _travels(error) else None,
            summary=" ".join(f"{type(error).__name__}: {error}".split()),
            trace="".join(traceback.format_exception(error)),
        )


def _travels(error: BaseException) -> bool:
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return False
    return True


def cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def load_extra(backend: str, package: str, load: Callable[[], ModuleType]) -> ModuleType:
    """Import the package of a backend, or say how to install it.

    Parameters
    ----------
    backend : str
        Name of the backend.
    package : str
        Package that it needs.
    load : callable
        Imports the module.

    Raises
    ------
    MissingExtra
        If it is not installed.
    """
    extra = "scale" if backend == "loky" else backend
    try:
        return load()
    except ImportError as error:
        raise MissingExtra(
            f"the backend {backend!r} needs {package}: install it with "
            f"pip install 'loose-env[{extra}]', or choose the backend 'threading', which needs "
            "nothing more"
        ) from error


class ThreadPool:
    """Threads of this process: for work that waits or that leaves Python, and to find errors.

    They share the process: its BLAS keeps the number of threads it was started with, and work
    that kills its process kills everything.
    """

    def __init__(self, settings: BackendSettings, most: int) -> None:
        self.size = min(settings.workers or cores(), most)
        self._threads = concurrent.futures.ThreadPoolExecutor(self.size, "shard")

    def submit(self, work: Callable[[Any], Any], shard: Any) -> Any:
        """Hand the call to a thread."""
        return self._threads.submit(guarded, work, shard)

    def wait(self, tickets: Sequence[Any]) -> Sequence[Any]:
        """Wait for one of the calls."""
        return _first_done(tickets)

    def result(self, ticket: Any) -> Any:
        """Result of a call."""
        return ticket.result()

    def close(self) -> None:
        """Start no more; a thread cannot be stopped, so what runs is left to end."""
        self._threads.shutdown(wait=False, cancel_futures=True)


class LokyPool:
    """Processes of this machine.

    Every worker is an executor of its own. A process that dies breaks its executor and no
    other: the shard at fault is known, and only that one is run again.
    """

    def __init__(self, settings: BackendSettings, most: int) -> None:
        self._loky = load_extra("loky", "joblib", _import_loky)
        self.size = min(settings.workers or self._loky.cpu_count(), most)
        self._free = [self._new() for _ in range(self.size)]
        self._busy: dict[Any, Any] = {}

    def submit(self, work: Callable[[Any], Any], shard: Any) -> Any:
        """Hand the call to a free process; one that died while it was idle is made anew."""
        executor = self._free.pop()
        try:
            ticket = executor.submit(guarded, work, shard)
        except concurrent.futures.BrokenExecutor:
            executor = self._new()
            ticket = executor.submit(guarded, work, shard)
        self._busy[ticket] = executor
        return ticket

    def wait(self, tickets: Sequence[Any]) -> Sequence[Any]:
        """Wait for one of the calls."""
        return _first_done(tickets)

    def result(self, ticket: Any) -> Any:
        """Result of a call."""
        executor = self._busy.pop(ticket)
        try:
            result = ticket.result()
        except self._loky.process_executor.TerminatedWorkerError as error:
            self._free.append(self._new())
            raise WorkerDied(_exit_code(error)) from error
        self._free.append(executor)
        return result

    def close(self) -> None:
        """Kill the processes; nobody waits for what they were doing."""
        executors = [*self._free, *self._busy.values()]
        for executor in executors:
            executor.shutdown(wait=False, kill_workers=True)
        self._free, self._busy = [], {}

    def _new(self) -> Any:
        return self._loky.process_executor.ProcessPoolExecutor(
            1, env=ONE_THREAD, initializer=_follow, initargs=(os.getpid(),)
        )


def _import_loky() -> ModuleType:
    return importlib.import_module("joblib.externals.loky")


def _follow(parent: int) -> None:
    """Make this worker end with its parent, and only with it."""
    # Ctrl-C reaches every process of the terminal; the parent ends its workers itself.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: int) -> None:
    """End this process once its parent was killed: nobody waits for its result any more."""
    while os.getppid() == parent:
        time.sleep(ORPHAN_CHECK)
    os._exit(1)


def _exit_code(error: BaseException) -> str:
    """Line of loky's message that tells how the process ended, or all of it."""
    lines = [line for line in str(error).splitlines() if "exit code" in line]
    return lines[0].strip() if lines else " ".join(str(error).split())


def _first_done(tickets: Sequence[Any]) -> Sequence[Any]:
    first = concurrent.futures.FIRST_COMPLETED
    done = concurrent.futures.wait(tickets, return_when=first).done
    return [ticket for ticket in tickets if ticket in done]
