"""Parallel tasks by joblib, stored results by episode, progress line.

No result depends on the backend, the number of workers, the size of a task or what was interrupted:
everything random in episode k comes from streams of its own, never from a worker or an order.
"""

from __future__ import annotations

import io
import json
import math
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path, PurePath
from typing import Any, Literal, TextIO

import joblib
import numpy as np
from joblib.externals.loky.process_executor import TerminatedWorkerError
from tqdm import tqdm

from loose_env.errors import InvalidData, InvalidSetting, LooseEnvError
from loose_env.evaluation import configuration_hash
from loose_env.io import Count, NonNegativeCount, write_bytes

_LINES = 10
"""Lines of a whole run where there is no terminal to write a line over."""


@dataclass(frozen=True, kw_only=True)
class BackendSettings:
    """Where the work runs; no result depends on it."""

    backend: Literal["loky", "threading"] = "loky"
    """Where the work runs: loky, processes on this machine; threading, threads of this process."""
    workers: Count | None = None
    """Tasks that run side by side; by default as many as there are cores."""
    retries: NonNegativeCount = 2
    """Times that tasks run again after a worker died."""


class WorkerDied(LooseEnvError, RuntimeError):
    """A task ended its worker process every time, by a signal, want of memory or its own exit."""

    def __init__(self, position: int, words: str) -> None:
        super().__init__(
            f"task {position} ended its worker every time ({words}): if memory ran out, use fewer "
            "workers or smaller tasks; if not, run it alone with --workers 1"
        )
        self.position = position
        """Number of the task among those given."""


def results_of(
    work: Callable[[Any], Any], tasks: Sequence[Any], settings: BackendSettings | None = None
) -> Iterator[tuple[int, Any]]:
    """Run the work for each task; yield positions and results as they come.

    Where a worker dies, all tasks without a result run again; after ``retries`` deaths one by one,
    so that the task at fault is known. What the work raises is raised here and not tried again.

    Examples
    --------
    >>> settings = BackendSettings(backend="threading", workers=2)
    >>> sorted(results_of(len, spans(5, 2), settings))
    [(0, 2), (1, 2), (2, 1)]
    """
    if not len(tasks):
        return
    chosen = settings or BackendSettings()
    done: set[int] = set()
    here = os.getpid()

    def run(positions: Sequence[int], workers: int) -> Iterator[tuple[int, Any]]:
        calls = (joblib.delayed(_numbered)(work, k, tasks[k]) for k in positions)
        own: dict[str, Any] = {}
        if chosen.backend == "loky":
            own = {"inner_max_num_threads": 1}
            own |= {"initializer": _end_with, "initargs": (here,)}
        with joblib.parallel_config(chosen.backend, **own):
            found = joblib.Parallel(
                workers, batch_size=1, pre_dispatch="n_jobs", return_as="generator_unordered"
            )(calls)
        for position, result in found:
            done.add(position)
            yield position, result

    workers = chosen.workers or joblib.cpu_count()  # one: this process
    workers = min(workers, max(2, len(tasks)))  # a lone task may still end its worker
    for deaths in range(chosen.retries + 1):
        try:
            yield from run([k for k in range(len(tasks)) if k not in done], workers)
            return
        except TerminatedWorkerError as error:
            words = (str(error).strip() or type(error).__name__).splitlines()[0]
            print(f"a worker died ({deaths + 1}): {words}", file=sys.stderr)
    for position in (k for k in range(len(tasks)) if k not in done):
        try:
            yield from run([position], 2)
        except TerminatedWorkerError as error:
            raise WorkerDied(position, words) from error


def _end_with(parent: int) -> None:
    """End this worker once the process that started it is gone, be it killed: nobody listens."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _numbered(work: Callable[[Any], Any], position: int, task: Any) -> tuple[int, Any]:
    return position, work(task)


def spans(total: int, size: int) -> list[range]:
    """Divide the episodes 0 to ``total - 1``; the last part may be shorter."""
    if total < 0 or size < 1:
        raise InvalidSetting(f"{total} episodes in parts of {size}: give a size of 1 or more")
    return [range(start, min(start + size, total)) for start in range(0, total, size)]


class Store:
    """Folder of results, a file for each span of episodes, all from one configuration.

    A file is named after its episodes, so spans of another size never mix. It is written beside its
    name and renamed: a run that is killed leaves whole files only.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     store = Store(folder, {"seed": 1})
    ...     store.write(range(2, 4), [{"episode": 2}, {"episode": 3}])
    ...     store.missing(spans(4, 2)), store.read(range(2, 4))
    ([range(0, 2)], [{'episode': 2}, {'episode': 3}])
    """

    def __init__(self, folder: str | Path, configuration: Any, *, arrays: bool = False) -> None:
        self.folder, self.arrays = Path(folder), arrays
        self.configuration = canonical(configuration)
        self.hash = configuration_hash(self.configuration)
        self.folder.mkdir(parents=True, exist_ok=True)
        described = self.folder / "configuration.json"
        if not described.exists():
            if any(self.folder.glob("shard-*")):
                raise InvalidSetting(
                    f"{self.folder} holds results and no {described.name}: what made them is "
                    "unknown; choose another folder or remove them"
                )
            content = {"hash": self.hash, "configuration": self.configuration}
            write_bytes(described, json.dumps(content, indent=1, sort_keys=True).encode())
            return
        try:
            before = json.loads(described.read_bytes())["configuration"]
        except (ValueError, KeyError, TypeError) as error:
            raise InvalidSetting(
                f"{described} cannot be read ({error}); choose another folder or remove this one"
            ) from error
        if unlike := self.unlike(before):
            raise InvalidSetting(
                f"{self.folder} holds results of another configuration: {unlike}; choose another "
                "folder, or remove this one to begin anew"
            )

    def path(self, span: range) -> Path:
        """File of a span, whether it exists or not."""
        suffix = ".npz" if self.arrays else ".json"
        return self.folder / f"shard-{span.start:09d}-{span.stop:09d}{suffix}"

    def missing(self, all_spans: Sequence[range]) -> list[range]:
        """Spans whose file is absent or broken; every file is read."""

        def holds(span: range) -> bool:
            try:
                self.read(span)
            except InvalidData:
                return False
            return True

        return [span for span in all_spans if not holds(span)]

    def write(self, span: range, value: Any) -> None:
        """Store the result of a span."""
        if self.arrays:
            buffer = io.BytesIO()
            np.savez(buffer, **value)
            write_bytes(self.path(span), buffer.getvalue())
        else:
            lines = ",\n".join(json.dumps(row, default=_plain_number) for row in value)
            write_bytes(self.path(span), f'{{"rows": [\n{lines}\n]}}\n'.encode())

    def read(self, span: range) -> Any:
        """Result of a span; `InvalidData` if it is not there, cut short or broken."""
        path = self.path(span)
        try:
            if not self.arrays:
                return json.loads(path.read_bytes())["rows"]
            with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
                return dict(stored)
        except Exception as error:  # zipfile, zlib, json and numpy raise a dozen kinds
            raise InvalidData(
                f"{path} is missing, cut short or broken ({error}); the same command makes it anew"
            ) from error

    def unlike(self, configuration: Any) -> str:
        """Differences between another configuration and this store's; may be empty."""
        old, new = dict(_leaves(configuration)), dict(_leaves(self.configuration))
        found = [
            f"{name} is {old.get(name, 'absent')} there and {new.get(name, 'absent')} here"
            for name in dict.fromkeys([*old, *new])
            if old.get(name) != new.get(name)
        ]
        return ", ".join(found[:8]) + (f" and {len(found) - 8} more" if len(found) > 8 else "")


def run_stored(
    work: Callable[[range], Any],
    all_spans: Sequence[range],
    store: Store,
    settings: BackendSettings | None = None,
) -> None:
    """Run the spans that a store lacks, and keep each result as it comes."""
    missing = store.missing(all_spans)
    total, left = sum(map(len, all_spans)), sum(map(len, missing))
    with ProgressLine(total, done=total - left) as line:
        for position, result in results_of(work, missing, settings):
            store.write(missing[position], result)
            line.advance(len(missing[position]))


def _plain_number(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{value!r} is a {type(value).__name__}")


def canonical(value: Any) -> Any:
    """Reduce a configuration to JSON types, with a unique form for each value.

    A dataclass counts with its name, so that two kinds with the same fields differ.
    """
    if is_dataclass(value) and not isinstance(value, type):
        named = {each.name: getattr(value, each.name) for each in fields(value)}
        return {"class": type(value).__name__, **canonical(named)}
    if isinstance(value, Mapping):
        return {str(name): canonical(part) for name, part in value.items()}
    if isinstance(value, (np.ndarray, np.generic)):
        return canonical(value.tolist())
    if isinstance(value, (list, tuple)):
        return [canonical(part) for part in value]
    if isinstance(value, PurePath):
        return value.as_posix()
    if isinstance(value, float) and value.is_integer() and abs(value) < 2.0**53:
        return int(value)
    if value is None or isinstance(value, (str, bool, int, float)):
        return value
    raise InvalidData(f"a configuration cannot hold {value!r} ({type(value).__name__})")


def _leaves(value: Any, name: str = "") -> Iterator[tuple[str, str]]:
    if isinstance(value, dict) and value:
        for key, part in value.items():
            yield from _leaves(part, f"{name}.{key}" if name else key)
    else:
        yield name or "configuration", json.dumps(value, ensure_ascii=False)


class ProgressLine(tqdm):  # type: ignore[misc]
    """Progress of counted work: one line on a terminal, a line for every tenth in a log."""

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
            miniters=None if over else max(1, math.ceil(total / _LINES)),
            delay=0.0 if over else 1e-9,
            leave=over,
        )

    def advance(self, units: int, words: str = "") -> None:
        """Add completed units; the words stand at the end of the line."""
        self.set_postfix_str(words, refresh=False)
        if not self.update(units) and self.n >= self.total:
            self.refresh()  # the last line of a log, where tenths do not divide the work


class _Lines:
    """File that turns the writing over one line into lines."""

    def __init__(self, stream: TextIO) -> None:
        self.stream, self.flush = stream, stream.flush

    def write(self, text: str) -> None:
        """Write what is left once returns and padding are gone."""
        if line := text.strip("\r\n").rstrip():
            self.stream.write(line + "\n")
