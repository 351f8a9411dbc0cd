"""Resumable training by PPO, on a posterior or on the raw observation, with its learning curve.

Everything is written beside its name and renamed. The checkpoint alone decides where a run goes
on: it holds the model with its optimiser, the step count and the evaluations so far, in one file.
"""

from __future__ import annotations

import csv
import importlib
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, astuple, dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.utils import set_random_seed

from loose_agents.base import CURVE_SEED, Problem
from loose_agents.belief import Tracker, make_estimator
from loose_agents.evaluation import evaluate, make_environments
from loose_agents.rl.agents import (
    CONFIGURATION,
    LearnedAgent,
    ModelAgent,
    described_run,
    layout_of,
    wrapped,
)
from loose_agents.rl.hyperparameters import LinearSchedule, algorithm_named, model_arguments, whole
from loose_agents.rl.model_files import TRAINED_ON, read_model, restore, zipped
from loose_agents.rl.networks import (
    FORMAT,
    WEIGHTS,
    RecordSetExtractor,
    network_of,
    record_set_arguments,
    save_network,
)
from loose_agents.rl.training_env import (
    TrackedVecEnv,
    evaluation_seed,
    forced_records,
    training_seed,
)
from loose_env.envs import ActionLayout, EnvBatch
from loose_env.envs.sb3 import Sb3VecEnv
from loose_env.errors import InvalidData, InvalidSetting
from loose_env.faults import UNSURE
from loose_env.io import write_bytes, write_text

ROOT = Path(__file__).resolve().parents[3]
STOP_BIAS = -1.5
"""Added to the logit of stopping at the start: early verdicts are mostly wrong, teach little."""
LEVEL_BIAS = 2.5
"""Added at the start to the logits of each joint's top level and of the last record length."""
NOT_COMPARED = ("n_timesteps", "versions", "git_commit", "command", "trained", "options")
"""Entries of a configuration that may differ when a run is resumed."""
_VERSIONS = ("loose_env", "gymnasium", "mujoco", "numpy", "stable_baselines3", "torch")
"""Packages whose versions are written beside a result."""
_STANDARDISING_STEPS = 8
"""Steps of each environment on whose records the set network's input is standardised."""


@dataclass(frozen=True, kw_only=True)
class Training:
    """One training: what learns, on what, how long, and where it is kept."""

    algorithm: str = "ppo"
    """Algorithm by its rl-zoo name."""
    estimator: str | None = "posterior"
    """Estimator on whose posterior it learns; None: on the environment's own observation."""
    network: Literal["flat", "set"] = "flat"
    """Layers on the flat observation, or after a set network over its records."""
    env: str
    """Id of the environment."""
    arguments: dict[str, Any]
    """Its arguments."""
    hyperparameters: dict[str, Any]
    """Hyperparameters, those of the environment's arguments taken out."""
    steps: int
    """Steps in all."""
    seconds: float | None = None
    """Wall-clock time in all, resumptions added up [s]; None without limit."""
    seed: int = 1
    """Seed of network and episodes."""
    evaluations: float = 0.0
    """Evaluations over the whole budget; 0: none."""
    eval_episodes: int = 200
    """Episodes of an evaluation."""
    last_episodes: int | None = None
    """Episodes of the last evaluation; None: as many as the others, and none before the first
    step."""
    eval_width: int = 64
    """Arms side by side in an evaluation."""
    save_freq: int = 0
    """Steps between checkpoints, at least one update of the policy; 0 for every update."""
    wrappers: tuple[str, ...] = ()
    """Wrappers of the environment's own observation and action, the first innermost."""
    training_prices: dict[str, float] = field(default_factory=dict)
    """Prices of the training alone; evaluations have the task's."""
    shaping: float = 0.0
    """Reward for a nat of log-posterior gained."""
    forced_records: int = 1
    """Records before which stopping is refused at the start."""
    forced_share: float = 0.0
    """Share of the steps after which it is refused no more."""
    device: str = "cpu"
    """Device of torch."""
    threads: int = 1
    """Threads of torch."""
    tensorboard: str = ""
    """Folder of the tensorboard log."""
    folder: Path
    """Folder of the run."""
    restart: bool = False
    """Forget what the folder holds."""

    @property
    def eval_seed(self) -> int:
        """Seed of the evaluations: of curves the same for all, else one of the run's own."""
        return CURVE_SEED if self.estimator is None else evaluation_seed(self.seed)

    def configuration(self, problem: Problem, **more: Any) -> dict[str, Any]:
        """Everything that the result depends on, with versions and commit, as read back."""
        own = {key: v for key, v in self.hyperparameters.items() if key != "n_timesteps"}
        found = {
            "format": FORMAT,
            "algorithm": self.algorithm,
            "network": self.network,
            "env": self.env,
            "env_kwargs": {key: v for key, v in self.arguments.items() if key != "threads"},
            "arm": problem.arm.name,
            "hypotheses": problem.hypotheses,
            "estimator": self.estimator,
            "wrappers": list(self.wrappers),
            "seed": self.seed,
            "n_timesteps": self.steps,
            "hyperparameters": own,
            "training": {
                "prices": self.training_prices,
                "shaping": self.shaping,
                "forced_records": self.forced_records,
                "forced_share": self.forced_share,
                "eval_episodes": self.eval_episodes,
            },
            "settings": asdict(problem.settings),
            **more,
            "versions": {
                "python": sys.version.split()[0],
                **{name: importlib.import_module(name).__version__ for name in _VERSIONS},
            },
            "git_commit": git_commit(ROOT),  # None outside a repository of its own
        }
        plain: dict[str, Any] = json.loads(json.dumps(found, default=str))
        return plain


class RunFolder:
    """File names of a run, following rl-zoo, and the curve beside them."""

    def __init__(self, root: Path) -> None:
        self.root, self.configuration, self.best = root, root / CONFIGURATION, root / "best"
        self.checkpoint, self.best_model = root / "checkpoint.zip", root / "best_model.zip"
        self.curve = root / "curve.csv"

    def clear(self) -> None:
        """Remove the files of an earlier run, the checkpoint first."""
        for path in (self.checkpoint, self.curve, self.best_model):
            path.unlink(missing_ok=True)
        (self.root / WEIGHTS).unlink(missing_ok=True)
        shutil.rmtree(self.best, ignore_errors=True)

    def export(self, target: Path) -> None:
        """Copy the best policy, or the last if none was evaluated, weights last."""
        source = self.best if (self.best / WEIGHTS).is_file() else self.root
        target.mkdir(parents=True, exist_ok=True)
        for name in (CONFIGURATION, WEIGHTS):
            beside = target / (name + ".part")
            shutil.copyfile(source / name, beside)
            beside.replace(target / name)


@dataclass(frozen=True, kw_only=True)
class CurvePoint:
    """Evaluation of a policy in training on held-out episodes."""

    steps: int
    """Steps of the training: records and verdicts."""
    records: int
    """Records of the training."""
    seconds: float
    """Time of the training, its evaluations included [s]."""
    episodes: int
    """Episodes of the evaluation."""
    mean_return: float
    """Their mean return."""
    return_error: float
    """Standard error of that mean."""
    right: float
    """Share of the episodes with the right verdict."""
    unsure: float
    """Share of the episodes with the verdict "unsure"."""
    records_per_episode: float
    """Mean number of records of an episode."""


def write_curve(path: Path, points: Sequence[CurvePoint]) -> None:
    """Write the points of a curve as CSV, one a line."""
    lines = [[each.name for each in fields(CurvePoint)]]
    for point in points:
        lines.append([f"{v:.6g}" if isinstance(v, float) else str(v) for v in astuple(point)])
    write_text(path, "".join(",".join(line) + "\n" for line in lines))


def read_curve(path: Path) -> list[CurvePoint]:
    """Read the points of a curve."""
    whole = ("steps", "records", "episodes")
    try:
        with path.open(newline="", encoding="utf-8") as file:
            return [
                CurvePoint(**{k: int(v) if k in whole else float(v) for k, v in line.items()})  # type: ignore[arg-type]
                for line in csv.DictReader(file)
            ]
    except (OSError, TypeError, ValueError) as error:
        raise InvalidData(f"{path} is no learning curve: {error}") from error


@dataclass
class RunState:
    """State of a run stored in its checkpoint beside the model."""

    points: list[dict[str, Any]] = field(default_factory=list)
    """Points of the learning curve."""
    best: float = -np.inf
    """The best mean return."""
    records: int = 0
    """Records taken."""
    seconds: float = 0.0
    """Time spent [s]."""


@dataclass
class Budget:
    """Steps and wall-clock time of a training; the one that runs out first ends it."""

    steps: int
    """Steps in all."""
    seconds: float | None = None
    """Time in all [s], over all resumptions; None without limit."""
    spent: float = 0.0
    """Time spent before this process took the run up [s]."""
    begun: float | None = None
    """Clock when it did."""

    def begin(self, spent: float) -> None:
        """Start the clock of a run that has taken some time already [s]."""
        self.spent, self.begun = spent, time.perf_counter()

    @property
    def elapsed(self) -> float:
        """Time of the run so far [s]."""
        return self.spent + (0.0 if self.begun is None else time.perf_counter() - self.begun)

    def timed_out(self) -> bool:
        """Return whether the time is spent."""
        return self.seconds is not None and self.elapsed >= self.seconds

    def left(self, steps_left: float) -> float:
        """Share of the budget that is left, 1 to 0, given the share of the steps that is."""
        if self.seconds is None:
            return steps_left
        return max(0.0, min(steps_left, 1.0 - self.elapsed / self.seconds))


class RunCallback(BaseCallback):
    """Saves checkpoints, evaluates, advances the curriculum and shows progress.

    All of it happens between updates, where the model is whole: the steps that it counts are
    those that it has learned from.
    """

    model: Any

    def __init__(
        self,
        run: Training,
        vec: Any,
        budget: Budget,
        configuration: dict[str, Any],
        batch: EnvBatch,
        estimator: Tracker | None,
        show: Callable[[int, str], None],
    ) -> None:
        super().__init__()
        self.batch, self.estimator = batch, estimator
        self.run, self.vec, self.budget, self.configuration = run, vec, budget, configuration
        self.show, self.folder = show, RunFolder(run.folder)

    @property
    def state(self) -> RunState:
        """Run state stored in the checkpoint with the model."""
        found: RunState = self.model.run_state
        return found

    def _on_training_start(self) -> None:
        self._saved, self._due = self.model.num_timesteps, self._number()
        if self.run.last_episodes is not None and not self.state.points:
            self._evaluate(self.run.eval_episodes)

    def _on_rollout_start(self) -> None:
        self._between_updates(last=False)

    def _on_training_end(self) -> None:
        self._between_updates(last=True)

    def _on_step(self) -> bool:
        # A step is a record or ends the episode with a verdict.
        self.state.records += int(np.count_nonzero(~self.locals["dones"]))
        return not self.budget.timed_out()

    def _last_point(self) -> int:
        """Steps at the last evaluation, -1 before the first."""
        return int(self.state.points[-1]["steps"]) if self.state.points else -1

    def _number(self) -> int:
        """Number of evaluations that are due."""
        left = self.budget.left(1.0 - self.model.num_timesteps / self.budget.steps)
        return int((1.0 - left) * self.run.evaluations + 1e-9)

    def _between_updates(self, *, last: bool) -> None:
        steps, run = self.model.num_timesteps, self.run
        self.vec.least_records = forced_records(
            steps / run.steps, first=run.forced_records, until=run.forced_share
        )
        if run.evaluations > 0:
            due, self._due = self._number() > self._due, self._number()
            if last and (run.last_episodes is not None or self._last_point() != steps):
                self._evaluate(run.last_episodes or run.eval_episodes)
            elif due and not last:
                self._evaluate(run.eval_episodes)
        if last or steps - self._saved >= max(run.save_freq, 1):
            self.save()
        if self.model.ep_info_buffer:
            returns = [each["r"] for each in self.model.ep_info_buffer]
            right = np.mean(self.model.ep_success_buffer)
            self.show(steps, f"last episodes: success {right:.3f}, return {np.mean(returns):+.3f}")

    def save(self) -> None:
        """Write the policy with its configuration, then the checkpoint."""
        steps = self.model.num_timesteps
        self._write_policy(self.folder.root, {"steps": steps})
        self.state.seconds = self.budget.elapsed
        write_bytes(self.folder.checkpoint, zipped(self.model, self.state))
        self._saved = steps

    def _evaluate(self, episodes: int) -> None:
        state, steps, batch = self.state, self.model.num_timesteps, self.batch
        problem = Problem.of(batch.arm, batch.settings)
        layout = None if self.estimator is not None else layout_of(self.vec.env)
        network = network_of(self.model, layout)
        agent: Any = (
            ModelAgent(problem, network, self.run.wrappers)
            if self.estimator is None
            else LearnedAgent(problem, network, self.estimator)
        )
        rows = evaluate(
            agent, "policy", problem.arm, problem.settings, episodes=episodes,
            seed=self.run.eval_seed, width=self.run.eval_width, threads=batch.threads,
            true_arm=batch.true_arm,
        )  # fmt: skip
        if self._last_point() == steps:  # the last one, of more episodes
            state.points.pop()
        returns = np.array([row.reward for row in rows])
        point = CurvePoint(
            steps=steps,
            records=state.records,
            seconds=round(self.budget.elapsed, 1),
            episodes=len(rows),
            mean_return=float(returns.mean()),
            return_error=float(returns.std() / np.sqrt(len(returns))),
            right=float(np.mean([row.success for row in rows])),
            unsure=float(np.mean([row.verdict == UNSURE for row in rows])),
            records_per_episode=float(np.mean([row.records for row in rows])),
        )
        state.points.append(asdict(point))
        write_curve(self.folder.curve, [CurvePoint(**each) for each in state.points])
        found = {
            "mean_reward": point.mean_return,
            "mean_ep_length": float(np.mean([row.records + (not row.truncated) for row in rows])),
            "success_rate": point.right,
        }
        for name, value in found.items():
            self.logger.record(f"eval/{name}", value)
        self.logger.dump(steps)
        if self.run.last_episodes is not None:
            self.show(
                steps,
                f"{point.records} records, {point.seconds:.0f} s: return {point.mean_return:+.3f}, "
                f"right {point.right:.3f}, unsure {point.unsure:.3f}, "
                f"{point.records_per_episode:.2f} records an episode",
            )
        if point.mean_return > state.best:
            state.best = point.mean_return
            self.folder.best.mkdir(exist_ok=True)
            self._write_policy(self.folder.best, {"steps": steps, **found})
            write_bytes(self.folder.best_model, zipped(self.model, self.state))

    def _write_policy(self, folder: Path, trained: dict[str, Any]) -> None:
        if self.run.estimator is not None:
            save_network(network_of(self.model), folder)
        write_json(folder / CONFIGURATION, {**self.configuration, "trained": trained})


def write_json(path: Path, content: object) -> None:
    """Write JSON."""
    write_bytes(path, (json.dumps(content, indent=1) + "\n").encode())


def train(
    run: Training,
    *,
    say: Callable[[str], None] = print,
    show: Callable[[int, str], None] | None = None,
    **described: Any,
) -> RunFolder:
    """Train, or go on from the last checkpoint, until the budget is spent.

    With a limit of steps alone and a CPU as device, same seed, same result; a limit of time depends
    on the machine.
    """
    model_class = algorithm_named(run.algorithm)
    given = model_arguments(run.hyperparameters, run.algorithm)  # refused before anything is made
    torch.set_num_threads(max(run.threads, 1))
    count = whole(run.hyperparameters.get("n_envs", 1), "n_envs")
    task = make_environments(run.env, 1, run.arguments)
    prices = replace(task.settings.prices, **run.training_prices)
    env = make_environments(run.env, count, run.arguments | {"prices": prices})
    problem = Problem.of(task.arm, task.settings)
    estimator = None if run.estimator is None else make_estimator(run.estimator, problem)
    further = 0 if estimator is None else estimator.feature_size
    configuration = run.configuration(problem, further_features=further, **described)
    folder = RunFolder(run.folder)
    vec: Any = (
        Sb3VecEnv(wrapped(env, run.wrappers))
        if estimator is None
        else TrackedVecEnv(env, problem, estimator, shaping=run.shaping)
    )
    budget = Budget(steps=run.steps, seconds=run.seconds)
    for name in ("learning_rate", "clip_range"):
        if isinstance(given.get(name), LinearSchedule):
            given[name].budget = budget
    if run.network == "set":
        own = dict(given.get("policy_kwargs") or {})
        own["features_extractor_kwargs"] = {
            **record_set_arguments(layout_of(vec.env)),
            **own.pop("features_extractor_kwargs", {}),
        }
        given["policy_kwargs"] = {**own, "features_extractor_class": RecordSetExtractor}
    given |= {
        "tensorboard_log": run.tensorboard or None, "seed": run.seed, "device": run.device
    }  # fmt: skip
    resumed = folder.checkpoint.is_file() and not run.restart
    try:
        if resumed:
            model = _checkpointed(run, folder, configuration, model_class, vec, given, problem)
            say(f"resumed from {folder.checkpoint} at {model.num_timesteps} steps")
        else:
            model = _new_model(run, model_class, vec, given, problem)
            model.run_state = RunState()
            folder.clear()  # only now: what was refused has taken nothing away
        setattr(model, TRAINED_ON, problem.fingerprint)
        state = model.run_state
        if model.num_timesteps >= run.steps or (run.seconds and state.seconds >= run.seconds):
            say(
                f"{folder.root} is trained already, {model.num_timesteps} steps in "
                f"{state.seconds:.0f} s"
            )
            return folder
        folder.root.mkdir(parents=True, exist_ok=True)
        write_json(folder.configuration, configuration)
        budget.begin(state.seconds)
        vec.seed(training_seed(run.seed, model.num_timesteps))
        if run.network == "set" and not resumed:
            state.records += standardise(model, vec)
        show = show or (lambda steps, words: None)
        if resumed:  # anew from here, as the episodes are
            set_random_seed(training_seed(run.seed, model.num_timesteps) % 2**32)
        if not run.tensorboard:
            model.set_logger(Logger(None, []))  # its own would leave an empty folder in /tmp
        callback = RunCallback(
            run,
            vec,
            budget,
            configuration,
            task.batch,
            estimator,
            show,
        )
        model.learn(
            run.steps - model.num_timesteps,
            callback=callback,
            tb_log_name=f"{run.algorithm}_{run.seed}",
            reset_num_timesteps=not resumed,
        )
    finally:
        vec.close()
    return folder


def _checkpointed(
    run: Training,
    folder: RunFolder,
    configuration: dict[str, Any],
    model_class: type[Any],
    vec: Any,
    given: dict[str, Any],
    problem: Problem,
) -> Any:
    """Load the model that a run goes on with; nothing in the file is run."""
    before = described_run(folder.root)
    keys = (set(before) | set(configuration)) - set(NOT_COMPARED)
    differ = sorted(key for key in keys if before.get(key) != configuration.get(key))
    if differ:
        raise InvalidSetting(
            f"{folder.root} holds a run with other {', '.join(differ)}; choose another folder or "
            "seed, or --restart to begin anew"
        )
    for name in ("versions", "git_commit"):
        if before.get(name) != configuration[name]:
            print(f"train: note: {name} differs from that of the run's start", file=sys.stderr)
    try:
        stored = read_model(folder.checkpoint, given["device"])
        # Made with the options of the run, which are those of its start: only tensors and counts
        # come from the file.
        model = _new_model(run, model_class, vec, given, problem)
        model.run_state = restore(stored, model, RunState)
    except InvalidData as error:
        raise InvalidData(
            f"cannot go on from {folder.checkpoint}; --restart begins anew: {error}"
        ) from error
    return model


def _strongest(actions: ActionLayout) -> list[int]:
    """Places, among all options one after the other, of top levels and the longest record."""
    first, levels = np.cumsum(actions.nvec) - actions.nvec, len(actions.arm.levels)
    entries = range(actions.excitation.start, actions.excitation.stop)
    tops = [first[e] + k for e in entries for k in range(levels, actions.nvec[e], levels)]
    return [*tops, first[-2] + int(np.argmax(actions.settings.durations))]


def _new_model(
    run: Training, model_class: type[Any], vec: Any, given: dict[str, Any], problem: Problem
) -> Any:
    """Make a model; on a posterior it begins with long, strong records and seldom stops."""
    try:
        model = model_class(env=vec, **given)
    except (AssertionError, TypeError, ValueError, KeyError, RuntimeError) as error:
        raise InvalidSetting(
            f"hyperparameters refused by {model_class.__name__}: {' '.join(str(error).split())}"
        ) from error
    if run.estimator is not None:
        with torch.no_grad():
            bias = model.policy.action_net.bias
            bias[torch.as_tensor(_strongest(problem.actions))] += LEVEL_BIAS
            bias[-1] += STOP_BIAS
    return model


def standardise(model: Any, vec: Any) -> int:
    """Standardise the set network's input on records of the untrained policy; count them."""
    observation, seen, taken = vec.reset(), [], 0
    for _ in range(_STANDARDISING_STEPS):
        masks = (
            {"action_masks": np.array(vec.env_method("action_masks"))}
            if hasattr(model.rollout_buffer, "action_masks")
            else {}
        )
        actions, _ = model.predict(observation, **masks)
        observation, _, over, _ = vec.step(actions)
        taken += int(np.count_nonzero(~over))
        seen.append(observation)
    model.policy.features_extractor.standardise(np.concatenate(seen))
    return taken


def git_commit(folder: Path) -> str | None:
    """Git commit of a folder, with "+" if dirty; None outside a repository of its own."""
    # Not that of somebody else around it; and it only looks: no lock stays behind a kill.
    git = ["git", f"--git-dir={folder / '.git'}", f"--work-tree={folder}"]
    environment = os.environ | {"GIT_OPTIONAL_LOCKS": "0"}
    try:
        head, changed = (
            subprocess.run(
                [*git, *words.split()], capture_output=True, text=True, check=True, env=environment
            ).stdout.strip()
            for words in ("rev-parse HEAD", "status --porcelain --untracked-files=no")
        )
    except (OSError, subprocess.CalledProcessError):
        return None
    return head + ("+" if changed else "")
