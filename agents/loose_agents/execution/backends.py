"""Settings of the execution backends and their command-line options."""

from __future__ import annotations

import argparse
from dataclasses import Field, dataclass, field, fields
from typing import Any

from loose_env.errors import InvalidSetting, UnknownName

__all__ = ["BACKENDS", "BackendSettings", "add_backend_options"]

BACKENDS = {
    "loky": "processes on this machine",
    "threading": "threads of this process",
    "ray": "a Ray cluster, or one started here",
    "dask": "a Dask cluster, or one started here",
    "slurm": "jobs of a Slurm cluster",
}
"""Name of each backend, and where it runs the work."""


def _option(default: Any, kind: type, words: str) -> Any:
    """Dataclass field that is also a command-line option."""
    return field(default=default, metadata={"type": kind, "help": words})


@dataclass(frozen=True, kw_only=True)
class BackendSettings:
    """Execution and retry settings of shards; results do not depend on them.

    The help of a field is the help of its option.

    Raises
    ------
    UnknownName
        If there is no such backend.
    InvalidSetting
        If a number lies outside its range.

    Examples
    --------
    >>> BackendSettings(backend="threading", workers=2).retries
    2
    """

    backend: str = _option(
        "loky", str, "where the work runs: " + "; ".join(f"{n}, {w}" for n, w in BACKENDS.items())
    )
    workers: int | None = _option(
        None, int, "shards run side by side; default: every core, for slurm 100 jobs"
    )
    retries: int = _option(2, int, "times a shard is run again after its worker died")
    ray_address: str | None = _option(
        None, str, "running Ray cluster, as in 'auto'; default: one on this machine"
    )
    dask_scheduler: str | None = _option(
        None, str, "running Dask scheduler, as in tcp://host:8786; default: one on this machine"
    )
    slurm_cluster: str = _option(
        "slurm", str, "submitit's kind of cluster: slurm; local or debug to try without one"
    )
    slurm_partition: str | None = _option(None, str, "partition; default: the cluster's own")
    slurm_time: int = _option(60, int, "time limit of a job [min]")
    slurm_memory: float | None = _option(
        None, float, "memory of a job [GB]; default: the cluster's own"
    )
    slurm_folder: str = _option("runs/slurm", str, "folder of the jobs' logs, seen by every node")

    def __post_init__(self) -> None:
        """Check the ranges."""
        if self.backend not in BACKENDS:
            raise UnknownName(
                f"there is no backend {self.backend!r}; there are {', '.join(BACKENDS)}"
            )
        if self.workers is not None and self.workers < 1:
            raise InvalidSetting(
                f"workers is {self.workers}; give 1 or more, or none for every core"
            )
        if self.retries < 0:
            raise InvalidSetting(f"retries is {self.retries}; it must be 0 or more")
        if self.slurm_time < 1:
            raise InvalidSetting(f"slurm_time is {self.slurm_time} min; it must be 1 or more")
        if self.slurm_memory is not None and not self.slurm_memory > 0:
            raise InvalidSetting(f"slurm_memory is {self.slurm_memory} GB; it must be above 0")

    @classmethod
    def of(cls, options: argparse.Namespace) -> BackendSettings:
        """Build settings from options parsed after `add_backend_options`."""
        return cls(**{f.name: getattr(options, f.name) for f in fields(cls)})


def add_backend_options(parser: argparse.ArgumentParser) -> None:
    """Add a command-line option for each field of `BackendSettings`.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        Parser of a script; read its options with `BackendSettings.of`.

    Examples
    --------
    >>> parser = argparse.ArgumentParser()
    >>> add_backend_options(parser)
    >>> options = parser.parse_args(["--backend", "ray", "--workers", "8"])
    >>> settings = BackendSettings.of(options)
    >>> settings.backend, settings.workers, settings.slurm_time
    ('ray', 8, 60)
    """
    group = parser.add_argument_group("where the work runs (no result depends on it)")
    for each in fields(BackendSettings):
        _add_option(group, each)


def _add_option(group: argparse._ArgumentGroup, each: Field[Any]) -> None:
    words = each.metadata["help"]
    if each.default is not None and "default" not in words:
        words += f"; default: {each.default}"
    group.add_argument(
        "--" + each.name.replace("_", "-"),
        type=each.metadata["type"],
        default=each.default,
        choices=tuple(BACKENDS) if each.name == "backend" else None,
        metavar=None if each.name == "backend" else each.metadata["type"].__name__.upper(),
        help=words.replace("%", "%%"),
    )
