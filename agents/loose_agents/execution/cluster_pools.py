"""Worker pools on clusters: Ray, Dask and Slurm."""

from __future__ import annotations

import logging
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import ModuleType
from typing import Any

from loose_agents.execution.backends import BackendSettings
from loose_agents.execution.local_pools import ONE_THREAD, WorkerDied, cores, guarded, load_extra
from loose_env.errors import InvalidSetting

__all__ = ["DaskPool", "RayPool", "SlurmPool"]

JOBS = 100  # Slurm jobs queued at once: few enough for the limits most clusters set per user
SHORTEST_PAUSE = 0.05  # [s] between two looks for the jobs' results
LONGEST_PAUSE = 2.0  # [s], so that a shared file system is not asked too often


class RayPool:
    """Ray tasks on a running cluster, one at an address, or a local one."""

    def __init__(self, settings: BackendSettings, most: int) -> None:
        self._ray: Any = load_extra("ray", "ray", _import_ray)
        self._started = not self._ray.is_initialized()
        if self._started:
            self._start(settings)
        available = int(self._ray.cluster_resources().get("CPU", 1))
        self.size = max(1, min(settings.workers or available, most))
        # A death is counted by the caller, in the same way for every backend.
        self._call = self._ray.remote(num_cpus=1, max_retries=0)(guarded)
        self._work: tuple[Any, Any] | None = None
        self._busy: set[Any] = set()

    def submit(self, work: Callable[[Any], Any], shard: Any) -> Any:
        """Submit a task; the function is serialised once for all shards."""
        if self._work is None or self._work[0] is not work:
            self._work = (work, self._ray.put(work))
        ticket = self._call.remote(self._work[1], shard)
        self._busy.add(ticket)
        return ticket

    def wait(self, tickets: Sequence[Any]) -> Sequence[Any]:
        """Wait for at least one task."""
        done: list[Any] = self._ray.wait(list(tickets), num_returns=1)[0]
        return done

    def result(self, ticket: Any) -> Any:
        """Result of a task."""
        gone = self._ray.exceptions
        self._busy.discard(ticket)
        try:
            return self._ray.get(ticket)
        except (
            gone.WorkerCrashedError,
            gone.OutOfMemoryError,
            gone.NodeDiedError,
            gone.ObjectLostError,
            gone.LocalRayletDiedError,
        ) as error:
            raise WorkerDied(_first_line(error)) from error

    def close(self) -> None:
        """Cancel running tasks and shut down a cluster started here."""
        for ticket in self._busy:
            self._ray.cancel(ticket, force=True)
        self._busy.clear()
        if self._started:
            self._ray.shutdown()

    def _start(self, settings: BackendSettings) -> None:
        quiet = {
            "include_dashboard": False,
            "log_to_driver": False,
            "logging_level": logging.ERROR,
        }
        silence = {"RAY_USAGE_STATS_ENABLED": "0", "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0"}
        with _environment({**ONE_THREAD, **silence}):
            if settings.ray_address is None:
                # address="local": a cluster that happens to run here is not joined unasked.
                number = settings.workers or cores()
                self._ray.init(address="local", num_cpus=number, **quiet)
            else:
                quiet.pop("include_dashboard")
                environment = {"env_vars": ONE_THREAD}
                try:
                    self._ray.init(settings.ray_address, runtime_env=environment, **quiet)
                except (ConnectionError, ValueError, RuntimeError) as error:
                    raise InvalidSetting(
                        f"no Ray cluster answers at {settings.ray_address}: {error}; start one "
                        "with 'ray start --head', or give no address to start one here"
                    ) from error


class DaskPool:
    """Dask tasks on a cluster at an address, or on a local one."""

    def __init__(self, settings: BackendSettings, most: int) -> None:
        self._dask: Any = load_extra("dask", "distributed", _import_distributed)
        self._cluster: Any = None
        if settings.dask_scheduler is None:
            self._cluster = self._local(min(settings.workers or cores(), most))
        try:
            self._client = self._dask.Client(self._cluster or settings.dask_scheduler)
        except (OSError, ValueError) as error:
            raise InvalidSetting(
                f"no Dask scheduler answers at {settings.dask_scheduler}: {error}; start one with "
                "'dask scheduler', or give no address to start one here"
            ) from error
        available = sum(self._client.nthreads().values())
        self.size = max(1, min(settings.workers or available, most))

    def submit(self, work: Callable[[Any], Any], shard: Any) -> Any:
        """Submit a task."""
        # Not pure: a key made from the arguments would hand back an earlier failure.
        return self._client.submit(guarded, work, shard, pure=False)

    def wait(self, tickets: Sequence[Any]) -> Sequence[Any]:
        """Wait for at least one task."""
        self._dask.wait(list(tickets), return_when="FIRST_COMPLETED")
        return [ticket for ticket in tickets if ticket.done()]

    def result(self, ticket: Any) -> Any:
        """Result of a task."""
        try:
            return ticket.result()
        except self._dask.KilledWorker as error:
            raise WorkerDied(_first_line(error)) from error

    def close(self) -> None:
        """Release the tasks, which cancels them; shut down a cluster started here."""
        self._client.close()
        if self._cluster is not None:
            self._cluster.close()

    def _local(self, workers: int) -> Any:
        from dask import config

        # One death is reported, not tried again by the scheduler: the caller counts deaths, in
        # the same way for every backend. A cluster elsewhere first tries as often as it is set to.
        counted = {
            "distributed.scheduler.allowed-failures": 0,
            "distributed.scheduler.worker-saturation": 1.0,
        }
        with config.set(counted):
            return self._dask.LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                dashboard_address=None,
                silence_logs=logging.CRITICAL,
                env=ONE_THREAD,
            )


class SlurmPool:
    """Slurm jobs through submitit, one per shard.

    A job takes seconds to begin: make shards of minutes.
    """

    def __init__(self, settings: BackendSettings, most: int) -> None:
        self._submitit: Any = load_extra("slurm", "submitit", _import_submitit)
        self.size = min(settings.workers or JOBS, most)
        try:
            self._executor = self._submitit.AutoExecutor(
                folder=settings.slurm_folder, cluster=settings.slurm_cluster
            )
        except (RuntimeError, ValueError) as error:
            raise InvalidSetting(
                f"submitit cannot use the cluster {settings.slurm_cluster!r}: {error}; run on a "
                "node that can queue Slurm jobs, or try with slurm_cluster 'local'"
            ) from error
        wanted = {
            "name": "loose-env",
            "timeout_min": settings.slurm_time,
            "cpus_per_task": 1,
            "mem_gb": settings.slurm_memory,
            "slurm_partition": settings.slurm_partition,
        }
        self._executor.update_parameters(**{k: v for k, v in wanted.items() if v is not None})
        self._busy: set[Any] = set()

    def submit(self, work: Callable[[Any], Any], shard: Any) -> Any:
        """Submit a job; it inherits the environment."""
        # What can be imported here can be imported there, if the file system is shared.
        with _environment({**ONE_THREAD, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}):
            job = self._executor.submit(guarded, work, shard)
        self._busy.add(job)
        return job

    def wait(self, tickets: Sequence[Any]) -> Sequence[Any]:
        """Poll until at least one job has finished."""
        pause = SHORTEST_PAUSE
        while not (done := [job for job in tickets if job.done()]):
            time.sleep(pause)
            pause = min(1.5 * pause, LONGEST_PAUSE)
        return done

    def result(self, ticket: Any) -> Any:
        """Result of a job; its logs stay in the folder."""
        self._busy.discard(ticket)
        try:
            result = ticket.result()
        except self._submitit.core.utils.FailedJobError:
            raise  # the job ended in order, but could not read the call
        except self._submitit.core.utils.UncompletedJobError as error:
            logs = (
                f"job {ticket.job_id} ended without a result (killed, out of memory or past its "
                f"time limit; its log is {ticket.paths.stderr})"
            )
            raise WorkerDied(logs) from error
        for file in (ticket.paths.result_pickle, ticket.paths.submitted_pickle):
            file.unlink(missing_ok=True)
        return result

    def close(self) -> None:
        """Cancel the unfinished jobs."""
        for job in self._busy:
            job.cancel(check=False)
        self._busy.clear()


@contextmanager
def _environment(variables: dict[str, str]) -> Iterator[None]:
    """Set environment variables temporarily, for child processes to inherit."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _first_line(error: BaseException) -> str:
    return (str(error).strip() or type(error).__name__).splitlines()[0]


def _import_ray() -> ModuleType:
    import ray

    return ray


def _import_distributed() -> ModuleType:
    import distributed

    return distributed


def _import_submitit() -> ModuleType:
    import submitit

    return submitit
