"""Settings of the execution backends."""

from __future__ import annotations

import argparse
from dataclasses import dataclass

from loose_agents.execution.command import add_options, option, options_of
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


@dataclass(frozen=True, kw_only=True)
class BackendSettings:
    """Execution and retry of shards; no result depends on it.

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

    backend: str = option(
        "loky",
        "where the work runs: " + "; ".join(f"{n}, {w}" for n, w in BACKENDS.items()),
        choices=tuple(BACKENDS),
    )
    workers: int | None = option(
        None, "shards run side by side; default: every core, for slurm 100 jobs"
    )
    retries: int = option(2, "times a shard is run again after its worker died")
    ray_address: str | None = option(
        None, "running Ray cluster, as in 'auto'; default: one on this machine"
    )
    dask_scheduler: str | None = option(
        None, "running Dask scheduler, as in tcp://host:8786; default: one on this machine"
    )
    slurm_cluster: str = option(
        "slurm", "submitit's kind of cluster: slurm; local or debug to try without one"
    )
    slurm_partition: str | None = option(None, "partition; default: the cluster's own")
    slurm_time: int = option(60, "time limit of a job [min]")
    slurm_memory: float | None = option(None, "memory of a job [GB]; default: the cluster's own")
    slurm_folder: str = option("runs/slurm", "folder of the jobs' logs, seen by every node")

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
    def of(cls, given: argparse.Namespace) -> BackendSettings:
        """Build settings from options parsed after `add_backend_options`."""
        return options_of(cls, given)


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
    add_options(parser, BackendSettings)
