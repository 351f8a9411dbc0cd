"""Worker process of parallel rollouts: simulates its share of the arms. It never imports torch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from loose_agents.execution.local_pools import follow_parent, guarded

__all__ = ["RolloutArrays", "WorkerTask", "serve"]

TRUTH = ("fault", "verdict", "is_success", "records")
"""Entries of an ended episode's info that the training reads."""


class RolloutArrays:
    """Arrays in memory shared by the training and its workers, a row for each arm.

    Observations alternate between two blocks: those of a step stay as they are during the next.
    The memory has no name that could outlive the processes.

    Parameters
    ----------
    context : multiprocessing context
        Starts the processes; an instance can be handed to a process only as it starts.
    num_envs : int
        Number of arms.
    observation, entries, choices : int
        Elements of an observation, entries of an action, and choices of all entries together.
    """

    def __init__(
        self, context: Any, num_envs: int, *, observation: int, entries: int, choices: int
    ) -> None:
        self._shapes: dict[str, tuple[tuple[int, ...], str]] = {
            "observations": ((2, num_envs, observation), "f4"),
            "final": ((num_envs, observation), "f4"),
            "actions": ((num_envs, entries), "i8"),
            "rewards": ((num_envs,), "f8"),
            "terminated": ((num_envs,), "?"),
            "truncated": ((num_envs,), "?"),
            "masks": ((num_envs, choices), "?"),
        }
        self._memory = {
            name: context.RawArray("b", int(np.prod(shape)) * np.dtype(kind).itemsize)
            for name, (shape, kind) in self._shapes.items()
        }

    def views(self) -> dict[str, NDArray[Any]]:
        """Arrays by name: observations (2, num_envs, size), the others (num_envs, ...)."""
        return {
            name: np.frombuffer(self._memory[name], dtype=kind).reshape(shape)
            for name, (shape, kind) in self._shapes.items()
        }


@dataclass(frozen=True, kw_only=True)
class WorkerTask:
    """Share of one worker."""

    env: str
    """Id of the environment."""
    arguments: dict[str, Any]
    """Its arguments."""
    first: int
    """Its first arm."""
    count: int
    """Number of its arms."""
    parent: int
    """Process that it works for; it ends with it."""


class _Arms:
    """The arms of one worker, stepped into the shared rows."""

    def __init__(self, task: WorkerTask, arrays: RolloutArrays) -> None:
        arguments = {**task.arguments, "threads": 1}
        self.env: Any = gymnasium.make_vec(task.env, num_envs=task.count, **arguments)
        rows = slice(task.first, task.first + task.count)
        views = arrays.views()
        self.observations = views.pop("observations")[:, rows]
        self.own = {name: array[rows] for name, array in views.items()}

    def answer(self, order: tuple[int, Any]) -> dict[int, dict[str, Any]]:
        """Follow an order: the block of the observations, and seeds and options, or None to step.

        Returns
        -------
        dict
            What is known of each ended episode, by the arm's number in this worker.
        """
        block, start = order
        if start is not None:
            return self._reset(block, *start)
        own = self.own
        observation, rewards, terminated, truncated, infos = self.env.step(own["actions"])
        self.observations[block] = observation
        own["rewards"][:], own["terminated"][:], own["truncated"][:] = (
            rewards,
            terminated,
            truncated,
        )
        own["masks"][:] = infos["action_mask"].tolist()
        ended: dict[int, dict[str, Any]] = {}
        for i in np.flatnonzero(terminated | truncated):
            own["final"][i] = infos["final_obs"][i]
            final = infos["final_info"]
            ended[int(i)] = {key: _plain(final[key][i]) for key in TRUTH}
        return ended

    def _reset(
        self, block: int, seeds: Sequence[int] | None, options: Sequence[Any] | None
    ) -> dict[int, dict[str, Any]]:
        given = None if options is None else {"env_options": options}
        observation, infos = self.env.reset(seed=seeds, options=given)
        self.observations[block] = observation
        self.own["masks"][:] = infos["action_mask"].tolist()
        return {}


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value


def serve(task: WorkerTask, arrays: RolloutArrays, connection: Connection) -> None:
    """Answer the orders that come until the connection is closed.

    Every answer is the ended episodes, or what was raised (`loose_agents.execution`'s ``Raised``).
    """
    follow_parent(task.parent)
    made: list[_Arms] = []

    def answer(order: tuple[int, Any]) -> Any:
        if not made:
            made.append(_Arms(task, arrays))
        return made[0].answer(order)

    while True:
        try:
            connection.send(guarded(answer, connection.recv()))
        except (EOFError, OSError):  # closed while waiting, or during the work
            return
