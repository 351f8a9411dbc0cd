"""Division of episodes into shards, run by any backend and number of workers.

Results do not depend on the backend, the number of workers, the size of a shard or what was
interrupted: everything random in episode k comes from its own streams
(`loose_env.envs.batch.Episode.stream`), never from a shard, a worker or the order of work.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from dataclasses import dataclass, fields, replace
from typing import Any, TextIO

from loose_agents.execution.backends import BackendSettings
from loose_agents.execution.cluster_pools import DaskPool, RayPool, SlurmPool
from loose_agents.execution.local_pools import LokyPool, Pool, Raised, ThreadPool, WorkerDied
from loose_agents.execution.progress import ProgressLine
from loose_agents.execution.shard_store import ShardStore
from loose_env.errors import InvalidSetting, LooseEnvError, UnknownName

__all__ = ["Shard", "ShardFailed", "map_shards", "run_shards", "shard_of"]

POOLS: dict[str, Callable[[BackendSettings, int], Pool]] = {
    "loky": LokyPool,
    "threading": ThreadPool,
    "ray": RayPool,
    "dask": DaskPool,
    "slurm": SlurmPool,
}


class ShardFailed(LooseEnvError, RuntimeError):
    """Shard without a result: its work raised, or its worker died too often."""


@dataclass(frozen=True, kw_only=True)
class Shard:
    """Contiguous range of episodes, ``start`` to ``stop - 1``.

    Raises
    ------
    InvalidSetting
        If it holds no episode or a number is negative.

    Examples
    --------
    >>> list(Shard(index=1, start=3, stop=6).episodes)
    [3, 4, 5]
    """

    index: int
    """Number of the shard among all, from 0."""
    start: int
    """Its first episode."""
    stop: int
    """The episode after its last."""

    def __post_init__(self) -> None:
        """Check that the shard is not empty."""
        if self.index < 0 or not 0 <= self.start < self.stop:
            raise InvalidSetting(
                f"shard {self.index} from {self.start} to {self.stop}: its number is 0 or more, "
                "and 0 <= start < stop"
            )

    @property
    def episodes(self) -> range:
        """Indices of the episodes."""
        return range(self.start, self.stop)

    def __len__(self) -> int:
        """Return the number of episodes."""
        return self.stop - self.start

    def __str__(self) -> str:
        """Return the shard's index and episode range, for messages."""
        return f"shard {self.index} (episodes {self.start} to {self.stop - 1})"


def shard_of(total: int, size: int) -> tuple[Shard, ...]:
    """Divide episodes 0 to ``total - 1`` into shards.

    Parameters
    ----------
    total : int
        Number of episodes, 0 or more.
    size : int
        Episodes a shard, 1 or more; the last shard may hold fewer.

    Returns
    -------
    tuple of Shard
        In order.

    Raises
    ------
    InvalidSetting
        If a number lies outside its range.

    Examples
    --------
    >>> [(shard.start, shard.stop) for shard in shard_of(5, 2)]
    [(0, 2), (2, 4), (4, 5)]
    """
    if total < 0 or size < 1:
        raise InvalidSetting(
            f"{total} episodes in shards of {size}: give 0 or more episodes and a size of 1 or more"
        )
    starts = range(0, total, size)
    return tuple(
        Shard(index=index, start=start, stop=min(start + size, total))
        for index, start in enumerate(starts)
    )


def map_shards(
    work: Callable[[Any], Any],
    shards: Sequence[Any],
    *,
    settings: BackendSettings | None = None,
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> Generator[tuple[int, Any], None, None]:
    """Run the work for each shard and yield results in order of completion.

    A shard whose worker dies (a kill, want of memory, an exit of its own) runs again, and no
    other with it. What the work itself raises is not tried again. Closing the iterator stops
    the work that is under way and ends the workers. Processes and jobs run BLAS, OpenMP and
    numba with one thread each; the backend ``threading`` keeps those of this process.

    Parameters
    ----------
    work : callable
        Takes a shard, returns its result. At the top of a module, or a `functools.partial` of
        such a function: it travels to other processes, as do its arguments and its result.
    shards : sequence
        `Shard`, or whatever else the work takes.
    settings : BackendSettings, optional
        Where it runs.
    progress : callable, optional
        Called with the number of shards done and of all, after each.
    **options
        Fields of `BackendSettings` to use instead of those of ``settings``.

    Yields
    ------
    tuple of int and result
        Position in ``shards`` and what the work returned for it; every position once.

    Raises
    ------
    ShardFailed
        If the work raised an error, which is the cause of this one, or if a shard's worker died
        more than ``retries`` times.
    MissingExtra
        If the backend is not installed.
    UnknownName, InvalidSetting
        If an option is unknown or lies outside its range.

    Examples
    --------
    >>> sorted(map_shards(len, shard_of(5, 2), backend="threading", workers=2))
    [(0, 2), (1, 2), (2, 1)]
    """
    return _mapped(work, shards, _settled(settings, options), progress)


def run_shards(
    work: Callable[[Shard], Any],
    shards: Sequence[Shard],
    store: ShardStore,
    *,
    settings: BackendSettings | None = None,
    unit: str = "episodes",
    stream: TextIO | None = None,
    **options: Any,
) -> int:
    """Run the shards missing from a store, and store each result on completion.

    Stopped at any moment, by Ctrl-C or by a kill, the store holds every shard that was done;
    the same call goes on from there, with any backend.

    Parameters
    ----------
    work : callable
        Takes a shard and returns what the store's codec takes; see `map_shards`.
    shards : sequence of Shard
        All shards; those in the store are left alone.
    store : ShardStore
        Where results go.
    settings : BackendSettings, optional
        Where it runs.
    unit : str
        What the numbers of a shard count, for the progress line.
    stream : text file, optional
        Where the progress line goes; standard error if None.
    **options
        Fields of `BackendSettings` to use instead of those of ``settings``.

    Returns
    -------
    int
        Number of shards that were run.

    Raises
    ------
    ShardFailed, MissingExtra, UnknownName, InvalidSetting
        As `map_shards` does.
    InvalidData
        If a result is not what the store's codec takes.
    """
    settled = _settled(settings, options)
    missing = store.missing(shards)
    total, left = sum(map(len, shards)), sum(map(len, missing))
    with (
        ProgressLine(total, done=total - left, unit=unit, stream=stream) as line,
        closing(_mapped(work, missing, settled, None)) as results,
    ):
        for position, result in results:
            store.write(missing[position], result)
            line.advance(len(missing[position]))
    return len(missing)


def _settled(settings: BackendSettings | None, options: dict[str, Any]) -> BackendSettings:
    allowed = [each.name for each in fields(BackendSettings)]
    unknown = sorted(set(options) - set(allowed))
    if unknown:
        raise UnknownName(
            f"there is no option {', '.join(unknown)} of a backend; there are {', '.join(allowed)}"
        )
    return replace(settings or BackendSettings(), **options)


def _mapped(
    work: Callable[[Any], Any],
    shards: Sequence[Any],
    settings: BackendSettings,
    progress: Callable[[int, int], None] | None,
) -> Generator[tuple[int, Any], None, None]:
    """Keep every worker busy until every shard has its result."""
    if not len(shards):
        return
    pool = POOLS[settings.backend](settings, len(shards))
    waiting = deque(range(len(shards)))
    running: dict[Any, int] = {}  # ticket -> position
    deaths: Counter[int] = Counter()
    done = 0
    try:
        while waiting or running:
            while waiting and len(running) < pool.size:
                position = waiting.popleft()
                running[pool.submit(work, shards[position])] = position
            for ticket in pool.wait(list(running)):
                position = running.pop(ticket)
                try:
                    result = pool.result(ticket)
                except WorkerDied as error:
                    deaths[position] += 1
                    if deaths[position] > settings.retries:
                        raise _died(position, shards[position], deaths[position], error) from error
                    waiting.appendleft(position)
                    continue
                except Exception as error:
                    raise _unsent(position, shards[position], error) from error
                if isinstance(result, Raised):
                    raise _raised(position, shards[position], result) from result.error
                done += 1
                if progress is not None:
                    progress(done, len(shards))
                yield position, result
    finally:
        pool.close()


def _name(position: int, shard: Any) -> str:
    return str(shard) if isinstance(shard, Shard) else f"shard {position}"


def _died(position: int, shard: Any, times: int, error: WorkerDied) -> ShardFailed:
    return ShardFailed(
        f"{_name(position, shard)}: its worker died {times} times, the last time with: {error}. "
        "If memory ran out, use fewer workers or smaller shards (a Slurm job may want more memory "
        "or time); if not, run the work on this shard alone to see what ends the process; allow "
        "more retries if the machines are at fault"
    )


def _unsent(position: int, shard: Any, error: Exception) -> ShardFailed:
    return ShardFailed(
        f"{_name(position, shard)}: the work, its arguments or its result could not travel "
        f"between processes ({type(error).__name__}: {error}). Use a function at the top of a "
        "module that the workers can import, and values that can be pickled"
    )


def _raised(position: int, shard: Any, raised: Raised) -> ShardFailed:
    failure = ShardFailed(f"{_name(position, shard)}: {raised.summary}")
    failure.add_note(f"Where the work raised it:\n{raised.trace}")
    return failure
