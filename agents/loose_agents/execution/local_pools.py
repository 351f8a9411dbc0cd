"""Local worker pools and the pool interface, including worker-death detection.

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
    "follow_parent",
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
    """Worker process ended by a signal, out of memory or by its own exit."""


@dataclass(frozen=True, kw_only=True)
class Raised:
    """Exception raised by a call, serialised alike by every backend."""

    error: BaseException | None
    """The exception; None where it cannot be pickled."""
    summary: str
    """Its kind and its words, in one line."""
    trace: str
    """Where it happened."""


class Pool(Protocol):
    """Pool of workers, each running one call; a ticket identifies a call."""

    size: int
    """Calls that run side by side."""

    def submit(self, work: Callable[[Any], Any], shard: Any) -> Any:
        """Submit a call of `guarded` to a free worker and return its ticket."""

    def wait(self, tickets: Sequence[Any]) -> Sequence[Any]:
        """Wait until at least one call has finished; return the finished tickets."""

    def result(self, ticket: Any) -> Any:
        """Result of a finished call; raise `WorkerDied` if its worker died."""

    def close(self) -> None:
        """Cancel running calls and shut down what the pool started."""


def guarded(work: Callable[[Any], Any], shard: Any) -> Any:
    """Run the call in a worker; exceptions are returned as `Raised`."""
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
    """Number of CPU cores available to this process."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def load_extra(backend: str, package: str, load: Callable[[], ModuleType]) -> ModuleType:
    """Import a backend's package, or raise with installation instructions.

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
    """Thread pool, for I/O or work that releases the GIL, and for debugging.

    They share the process: its BLAS keeps the number of threads it was started with, and work
    that kills its process kills everything.
    """

    def __init__(self, settings: BackendSettings, most: int) -> None:
        self.size = min(settings.workers or cores(), most)
        self._threads = concurrent.futures.ThreadPoolExecutor(self.size, "shard")

    def submit(self, work: Callable[[Any], Any], shard: Any) -> Any:
        """Submit the call to a thread."""
        return self._threads.submit(guarded, work, shard)

    def wait(self, tickets: Sequence[Any]) -> Sequence[Any]:
        """Wait for at least one call."""
        return _first_done(tickets)

    def result(self, ticket: Any) -> Any:
        """Result of a call."""
        return ticket.result()

    def close(self) -> None:
        """Start no further calls; running threads are left to finish."""
        self._threads.shutdown(wait=False, cancel_futures=True)


class LokyPool:
    """Process pool on this machine, through loky.

    Every worker is an executor of its own. A process that dies breaks its executor and no
    other: the shard at fault is known, and only that one is run again.
    """

    def __init__(self, settings: BackendSettings, most: int) -> None:
        self._loky = load_extra("loky", "joblib", _import_loky)
        self.size = min(settings.workers or self._loky.cpu_count(), most)
        self._free = [self._new() for _ in range(self.size)]
        self._busy: dict[Any, Any] = {}

    def submit(self, work: Callable[[Any], Any], shard: Any) -> Any:
        """Submit the call to a free process, replacing one that died while idle."""
        executor = self._free.pop()
        try:
            ticket = executor.submit(guarded, work, shard)
        except concurrent.futures.BrokenExecutor:
            executor = self._new()
            ticket = executor.submit(guarded, work, shard)
        self._busy[ticket] = executor
        return ticket

    def wait(self, tickets: Sequence[Any]) -> Sequence[Any]:
        """Wait for at least one call."""
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
        """Kill the processes; their pending results are discarded."""
        executors = [*self._free, *self._busy.values()]
        for executor in executors:
            executor.shutdown(wait=False, kill_workers=True)
        self._free, self._busy = [], {}

    def _new(self) -> Any:
        return self._loky.process_executor.ProcessPoolExecutor(
            1, env=ONE_THREAD, initializer=follow_parent, initargs=(os.getpid(),)
        )


def _import_loky() -> ModuleType:
    return importlib.import_module("joblib.externals.loky")


def follow_parent(parent: int) -> None:
    """Tie this worker's lifetime to its parent's, and leave Ctrl-C to the parent."""
    # Ctrl-C reaches every process of the terminal; the parent ends its workers itself.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: int) -> None:
    """Exit once the parent process has been killed."""
    while os.getppid() == parent:
        time.sleep(ORPHAN_CHECK)
    os._exit(1)


def _exit_code(error: BaseException) -> str:
    """Extract the exit code from loky's message, or return the whole message."""
    lines = [line for line in str(error).splitlines() if "exit code" in line]
    return lines[0].strip() if lines else " ".join(str(error).split())


def _first_done(tickets: Sequence[Any]) -> Sequence[Any]:
    first = concurrent.futures.FIRST_COMPLETED
    done = concurrent.futures.wait(tickets, return_when=first).done
    return [ticket for ticket in tickets if ticket in done]
