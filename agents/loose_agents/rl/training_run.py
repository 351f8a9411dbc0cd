"""Resumable training run: checkpoints, evaluations and the best policy.

Everything is written beside its name and renamed. The checkpoint alone decides where a run goes
on: it holds the model with its optimiser, the step count, the states of the random generators and
the evaluations so far, in one file.
"""

from __future__ import annotations

import importlib
import io
import json
import os
import random
import shutil
import subprocess
import sys
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback

from loose_agents.evaluation.evaluate import EpisodeRow
from loose_agents.rl.checkpoint import zipped
from loose_agents.rl.learned_policy import CONFIGURATION
from loose_agents.rl.network import WEIGHTS, PolicyNetwork, network_of, save_network
from loose_agents.rl.training_env import TrackedVecEnv, forced_records
from loose_env.errors import InvalidData
from loose_env.io import write_bytes

__all__ = [
    "GeneratorStates",
    "RunCallback",
    "RunFolder",
    "RunState",
    "Schedule",
    "differences",
    "git_commit",
    "with_versions",
    "write_json",
    "write_model",
]

_VERSIONS = ("loose_env", "gymnasium", "mujoco", "numpy", "stable_baselines3", "torch")
"""Packages whose versions are written beside a result."""
NOT_COMPARED = ("n_timesteps", "versions", "git_commit", "command", "trained", "options")
"""Entries that may differ when a run is resumed."""


@dataclass(frozen=True)
class RunFolder:
    """File names of a run, following rl-zoo."""

    root: Path
    """The run's own folder."""

    @property
    def checkpoint(self) -> Path:
        """Checkpoint from which the run resumes."""
        return self.root / "checkpoint.zip"

    @property
    def configuration(self) -> Path:
        """Configuration file with every setting that determines the result."""
        return self.root / CONFIGURATION

    @property
    def evaluations(self) -> Path:
        """Steps, returns, lengths and successes of the evaluations."""
        return self.root / "evaluations.npz"

    @property
    def best(self) -> Path:
        """Folder of the policy with the best evaluation."""
        return self.root / "best"

    @property
    def best_model(self) -> Path:
        """Best policy as a stable-baselines3 model."""
        return self.root / "best_model.zip"

    def clear(self) -> None:
        """Remove the files of an earlier run, the checkpoint first."""
        for path in (self.checkpoint, self.evaluations, self.best_model, self.root / WEIGHTS):
            path.unlink(missing_ok=True)
        shutil.rmtree(self.best, ignore_errors=True)

    def described(self) -> dict[str, Any]:
        """Read the configuration.

        Raises
        ------
        InvalidData
            If it is missing or cannot be read.
        """
        try:
            found = json.loads(self.configuration.read_text(encoding="utf-8"))
        except (OSError, json.JSONDecodeError) as error:
            raise InvalidData(f"no configuration of a run at {self.configuration}") from error
        if not isinstance(found, dict):
            raise InvalidData(f"{self.configuration} must hold a JSON object")
        return found


@dataclass
class GeneratorStates:
    """States of the global random generators, stored in a checkpoint."""

    generators: dict[str, Any] = field(default_factory=dict)
    """States of the generators of Python, numpy and torch."""

    def remember_generators(self) -> None:
        """Store the states of the global random generators."""
        import torch

        self.generators = {
            "python": random.getstate(),
            "numpy": np.random.get_state(),
            "torch": torch.get_rng_state().numpy().copy(),
        }

    def restore_generators(self) -> None:
        """Restore the states of the global random generators.

        Raises
        ------
        InvalidData
            If they are no states of these generators.
        """
        import torch

        if self.generators:
            try:
                random.setstate(self.generators["python"])
                np.random.set_state(self.generators["numpy"])
                torch.set_rng_state(torch.from_numpy(self.generators["torch"]))
            except (KeyError, TypeError, ValueError, RuntimeError) as error:
                raise InvalidData(
                    f"the generators of the run cannot be restored ({error}); --restart begins anew"
                ) from error


@dataclass
class RunState(GeneratorStates):
    """Run state stored in a checkpoint beside the model."""

    steps: list[int] = field(default_factory=list)
    """When the evaluations took place."""
    returns: list[list[float]] = field(default_factory=list)
    """Unshaped returns of their episodes."""
    lengths: list[list[int]] = field(default_factory=list)
    """Steps of their episodes."""
    successes: list[list[bool]] = field(default_factory=list)
    """Correctness of their verdicts."""
    best: float = -np.inf
    """The best mean return."""


def write_model(path: Path, model: Any) -> None:
    """Write a stable-baselines3 model with the run state."""
    write_bytes(path, zipped(model, model.run_state))


def write_json(path: Path, content: object) -> None:
    """Write JSON."""
    write_bytes(path, (json.dumps(content, indent=1) + "\n").encode())


def differences(before: dict[str, Any], now: dict[str, Any]) -> list[str]:
    """List differences between configurations, except in permitted entries."""
    keys = (set(before) | set(now)) - set(NOT_COMPARED)
    plain = json.loads(json.dumps(now))
    return sorted(key for key in keys if before.get(key) != plain.get(key))


def with_versions(configuration: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Configuration of a training with versions and commit, as read back from its file.

    Parameters
    ----------
    configuration : mapping
        What the result depends on otherwise.
    folder : Path
        The repository.
    """
    found = {
        **configuration,
        "versions": {
            "python": sys.version.split()[0],
            **{name: importlib.import_module(name).__version__ for name in _VERSIONS},
        },
        "git_commit": git_commit(folder),  # None outside a repository of its own
    }
    plain: dict[str, Any] = json.loads(json.dumps(found, default=str))
    return plain


def git_commit(folder: Path) -> str | None:
    """Git commit of a folder, with "+" if dirty; None outside a repository."""

    def ask(*words: str) -> str:
        return subprocess.run(
            ["git", "-C", str(folder), *words],
            capture_output=True,
            text=True,
            check=True,
            # It only looks: no lock that would stay behind if it were cut short.
            env=os.environ | {"GIT_OPTIONAL_LOCKS": "0"},
        ).stdout.strip()

    try:
        # The folder may lie in somebody else's repository.
        if Path(ask("rev-parse", "--show-toplevel")).resolve() != folder.resolve():
            return None
        changed = ask("status", "--porcelain", "--untracked-files=no")
        return ask("rev-parse", "HEAD") + ("+" if changed else "")
    except (OSError, subprocess.CalledProcessError):
        return None


@dataclass(frozen=True, kw_only=True)
class Schedule:
    """Schedule of the events of a run, in environment steps."""

    total: int
    """Steps in all."""
    save_freq: int = 0
    """Steps between checkpoints, at least one update of the policy; 0 for every update."""
    eval_freq: int = 0
    """Steps between evaluations; 0 or less for none."""
    forced: int = 3
    """Records before which stopping is refused at the start."""
    forced_share: float = 0.4
    """Share of the steps after which it is refused no more."""


class RunCallback(BaseCallback):
    """Saves checkpoints, evaluates, advances the curriculum and shows progress.

    All of it happens between updates, where the model is whole: the steps that it counts are
    those that it has learned from.

    Parameters
    ----------
    folder : RunFolder
        Where the run lies.
    vec : TrackedVecEnv
        The environments of the training.
    schedule : Schedule
        When what happens.
    configuration : dict
        Written beside every policy.
    evaluate : callable
        Plays the evaluation episodes with a network.
    show : callable
        Called after every update with the steps so far and a line of words.
    """

    model: Any

    def __init__(
        self,
        folder: RunFolder,
        vec: TrackedVecEnv,
        schedule: Schedule,
        configuration: dict[str, Any],
        evaluate: Callable[[PolicyNetwork], Sequence[EpisodeRow]],
        show: Callable[[int, str], None],
    ) -> None:
        super().__init__()
        self.folder, self.vec, self.schedule = folder, vec, schedule
        self.configuration, self.evaluate, self.show = configuration, evaluate, show
        self._saved = -1
        self._episodes = 0
        self._successes: deque[bool] = deque(maxlen=500)
        self._returns: deque[float] = deque(maxlen=500)

    @property
    def state(self) -> RunState:
        """Run state stored in the checkpoint with the model."""
        found: RunState = self.model.run_state
        return found

    def _on_training_start(self) -> None:
        self._saved = self.model.num_timesteps
        self._evaluated = self.model.num_timesteps

    def _on_rollout_start(self) -> None:
        self._between_updates(last=False)

    def _on_training_end(self) -> None:
        self._between_updates(last=True)

    def _on_step(self) -> bool:
        for info in self.locals["infos"]:
            if "is_success" in info:
                self._episodes += 1
                self._successes.append(bool(info["is_success"]))
                self._returns.append(float(info["episode"]["r"]))
        return True

    def _between_updates(self, *, last: bool) -> None:
        steps, plan = self.model.num_timesteps, self.schedule
        self.vec.least_records = forced_records(
            steps / plan.total, first=plan.forced, until=plan.forced_share
        )
        if plan.eval_freq > 0:
            due = steps // plan.eval_freq > self._evaluated // plan.eval_freq
            if due or (last and self.state.steps[-1:] != [steps]):
                self._evaluate(steps)
        if last or steps - self._saved >= max(plan.save_freq, 1):
            self.save()
        if self._successes:
            self.show(
                steps,
                f"{self._episodes} episodes, success {np.mean(self._successes):.3f}, "
                f"return {np.mean(self._returns):+.3f}",
            )

    def save(self) -> None:
        """Write the policy with its configuration, then the checkpoint."""
        steps = self.model.num_timesteps
        self._write_policy(self.folder.root, {"steps": steps})
        self.state.remember_generators()
        write_model(self.folder.checkpoint, self.model)
        self._saved = steps

    def _evaluate(self, steps: int) -> None:
        rows = self.evaluate(network_of(self.model))
        self._evaluated = steps
        state = self.state
        state.steps.append(steps)
        state.returns.append([row.reward for row in rows])
        state.lengths.append([row.records + (not row.truncated) for row in rows])
        state.successes.append([row.success for row in rows])
        buffer = io.BytesIO()
        np.savez(
            buffer,
            timesteps=state.steps,
            results=state.returns,
            ep_lengths=state.lengths,
            successes=state.successes,
        )
        write_bytes(self.folder.evaluations, buffer.getvalue())
        found = {
            "mean_reward": float(np.mean(state.returns[-1])),
            "mean_ep_length": float(np.mean(state.lengths[-1])),
            "success_rate": float(np.mean(state.successes[-1])),
        }
        for name, value in found.items():
            self.logger.record(f"eval/{name}", value)
        self.logger.dump(steps)
        if found["mean_reward"] > state.best:
            state.best = found["mean_reward"]
            self.folder.best.mkdir(exist_ok=True)
            self._write_policy(self.folder.best, {"steps": steps, **found})
            write_model(self.folder.best_model, self.model)

    def _write_policy(self, folder: Path, trained: dict[str, Any]) -> None:
        save_network(network_of(self.model), folder)
        write_json(folder / CONFIGURATION, {**self.configuration, "trained": trained})
