"""Environments of a training simulated by several worker processes."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Sequence
from itertools import pairwise
from multiprocessing.connection import wait
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices

from loose_agents.execution.local_pools import ONE_THREAD, Raised
from loose_agents.rl.end_to_end.rollout_worker import RolloutArrays, WorkerTask, serve
from loose_env.envs import DiagnosisVectorEnv, batch_seeds
from loose_env.envs.sb3 import Sb3VecEnv
from loose_env.errors import InvalidSetting

__all__ = ["ParallelVecEnv"]

_GRACE = 5.0  # [s] for a worker to end by itself


class ParallelVecEnv(VecEnv):
    """Vector environment of stable-baselines3 whose arms are simulated by worker processes.

    Each worker has a native vector environment of its own and writes into shared memory. The
    episodes are those of `Sb3VecEnv` at the same seed, bit for bit, for any number of workers: an
    arm's seed goes by its number, and its episodes do not depend on the arms beside it.

    An array of observations is overwritten by the step after the next one. The info of an arm is
    empty until its episode ends; then it has what the training reads: ``fault``, ``verdict``,
    ``is_success``, ``records``, and stable-baselines3's own entries.

    Parameters
    ----------
    env : DiagnosisVectorEnv
        One such environment, for spaces and attributes; it is not stepped.
    env_id : str
        Its id.
    arguments : dict
        Its arguments, as given to ``gymnasium.make_vec``.
    num_envs : int
        Number of arms, shared out as evenly as can be.
    workers : int
        Number of processes.

    Raises
    ------
    InvalidSetting
        If there are more workers than arms, or the observation is not flat.
    ChildProcessError
        From any method, once a worker has died.
    """

    def __init__(
        self,
        env: DiagnosisVectorEnv,
        env_id: str,
        arguments: dict[str, Any],
        *,
        num_envs: int,
        workers: int,
    ) -> None:
        if not 1 <= workers <= num_envs:
            raise InvalidSetting(
                f"{workers} workers for {num_envs} environments: each worker needs one or more; "
                "choose fewer workers or a larger n_envs"
            )
        if env.settings.raw:
            raise InvalidSetting("workers share flat observations: leave raw out")
        self._one = Sb3VecEnv(env)
        super().__init__(num_envs, env.single_observation_space, env.single_action_space)
        context: Any = multiprocessing.get_context("spawn")  # torch's threads do not survive a fork
        nvec = env.actions.nvec
        arrays = RolloutArrays(
            context,
            num_envs,
            observation=int(np.prod(env.single_observation_space.shape or ())),
            entries=len(nvec),
            choices=int(nvec.sum()),
        )
        self._shared = arrays.views()
        self._block = 0
        self._returns = np.zeros(num_envs)
        self._lengths = np.zeros(num_envs, dtype=int)
        bounds = np.linspace(0, num_envs, workers + 1).astype(int)
        self._rows = [slice(int(a), int(b)) for a, b in pairwise(bounds)]
        self._workers: list[tuple[Any, Any]] = []
        before = {name: os.environ.get(name) for name in ONE_THREAD}
        os.environ.update(ONE_THREAD)  # the workers' libraries read it as they are imported
        try:
            for rows in self._rows:
                task = WorkerTask(
                    env=env_id,
                    arguments=arguments,
                    first=rows.start,
                    count=rows.stop - rows.start,
                    parent=os.getpid(),
                )
                ours, theirs = context.Pipe()
                process = context.Process(target=serve, args=(task, arrays, theirs), daemon=True)
                process.start()
                theirs.close()  # so that a worker's death ends the connection
                self._workers.append((process, ours))
        except BaseException:
            self.close()
            raise
        finally:
            for name, value in before.items():
                if value is None:
                    del os.environ[name]
                else:
                    os.environ[name] = value

    def seed(self, seed: int | None = None) -> list[int | None]:
        """Seed the next reset, by `loose_env.envs.batch_seeds` over all arms."""
        chosen = np.random.SeedSequence().entropy if seed is None else seed
        self._seeds = [*batch_seeds(int(chosen), self.num_envs)]  # type: ignore[arg-type]
        return list(self._seeds)

    def reset(self) -> NDArray[np.float32]:
        """Begin an episode on every arm; observations (num_envs, size)."""
        seeded = any(seed is not None for seed in self._seeds)
        options = self._options if any(self._options) else None
        self._order(
            [
                (self._seeds[rows] if seeded else None, None if options is None else options[rows])
                for rows in self._rows
            ]
        )
        self._answers()
        self.reset_infos = [{} for _ in range(self.num_envs)]
        self._returns[:], self._lengths[:] = 0.0, 0
        self._reset_seeds()
        self._reset_options()
        return self._observations()

    def step_async(self, actions: NDArray[Any]) -> None:
        """Set all workers to a step."""
        self._shared["actions"][:] = actions
        self._order([None] * len(self._workers))

    def step_wait(self) -> Any:
        """Wait for the step of all workers."""
        answers = self._answers()
        shared = self._shared
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        self._returns += shared["rewards"]
        self._lengths += 1
        for rows, ended in zip(self._rows, answers, strict=True):
            for k, known in ended.items():
                i = rows.start + k
                cut = bool(shared["truncated"][i] and not shared["terminated"][i])
                infos[i] = {
                    **known,
                    "terminal_observation": shared["final"][i].copy(),
                    "TimeLimit.truncated": cut,
                    "episode": {"r": float(self._returns[i]), "l": int(self._lengths[i])},
                }
                self._returns[i], self._lengths[i] = 0.0, 0
        done = shared["terminated"] | shared["truncated"]
        return self._observations(), shared["rewards"].astype(np.float32), done, infos

    def close(self) -> None:
        """End the workers."""
        workers, self._workers = self._workers, []
        for _, connection in workers:
            connection.close()
        for process, _ in workers:
            process.join(_GRACE)
            if process.is_alive():
                process.kill()
                process.join()

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Attribute of the environments; it is the same object for all."""
        return self._one.get_attr(attr_name, [0]) * len([*self._get_indices(indices)])

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Refuse, as the environments of a batch do."""
        self._one.set_attr(attr_name, value)

    def has_attr(self, attr_name: str) -> bool:
        """Return whether the environments have an attribute or a method."""
        return self._one.has_attr(attr_name)

    def env_method(
        self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any
    ) -> list[Any]:
        """Call a method; of the environments' own methods, only ``action_masks`` exists."""
        if method_name != "action_masks":
            return self._one.env_method(method_name, *args, indices=indices, **kwargs)
        masks = self._shared["masks"].copy()
        return [masks[i] for i in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: type[Any], indices: VecEnvIndices = None) -> list[bool]:
        """Return False for every environment: none is wrapped."""
        return [False for _ in self._get_indices(indices)]

    def _observations(self) -> NDArray[np.float32]:
        found: NDArray[np.float32] = self._shared["observations"][self._block]
        return found

    def _order(self, given: Sequence[Any]) -> None:
        """Give every worker an order; it fills the block that is not in use."""
        self._block = 1 - self._block
        for k, ((_, connection), each) in enumerate(zip(self._workers, given, strict=True)):
            try:
                connection.send((self._block, each))
            except OSError as error:
                raise self._died(k) from error

    def _answers(self) -> list[dict[int, dict[str, Any]]]:
        """Answers of all workers, in their order."""
        waiting: dict[Any, int] = {each[1]: k for k, each in enumerate(self._workers)}
        found: list[Any] = [None] * len(waiting)
        while waiting:
            ready: list[Any] = wait([*waiting])
            for connection in ready:  # a dead worker's connection is at its end
                k = waiting.pop(connection)
                try:
                    found[k] = connection.recv()
                except (EOFError, OSError) as error:
                    raise self._died(k) from error
                if isinstance(found[k], Raised):
                    raise found[k].error or RuntimeError(found[k].summary)
        return found

    def _died(self, k: int) -> ChildProcessError:
        process = self._workers[k][0]
        process.join(_GRACE)
        code = process.exitcode
        how = "stopped answering"
        if code is not None:
            how = (
                f"exited with code {code}" if code >= 0 else f"died by {signal.Signals(-code).name}"
            )
        return ChildProcessError(
            f"rollout worker {k + 1} of {len(self._workers)} (process {process.pid}) {how}; "
            "SIGKILL often means that memory ran out: choose fewer workers or a smaller n_envs"
        )
