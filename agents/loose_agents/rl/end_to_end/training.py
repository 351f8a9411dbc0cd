"""Training from scratch on the environment's own observation and action, with a learning curve."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from loose_agents.core.base import Problem
from loose_agents.core.seeds import CURVE_SEED
from loose_agents.evaluation.env_arguments import make_environments
from loose_agents.rl.hyperparameters import (
    HYPERPARAMETERS,
    LinearSchedule,
    algorithm_named,
    model_arguments,
    read_hyperparameters,
    whole,
)
from loose_env.arms import Arm
from loose_env.errors import InvalidData, InvalidSetting, UnknownName
from loose_env.faults import UNSURE

__all__ = ["LEARNERS", "Job", "Learner", "run_folder", "train_end_to_end"]

_STANDARDISING_STEPS = 8
"""Random actions of each environment on whose records the set network's input is standardised."""


_INFERENCE_RATE = 2e-3
"""Learning rate of the posterior at the start."""


@dataclass(frozen=True, kw_only=True)
class Learner:
    """An algorithm with a network and a hyperparameter file."""

    algorithm: str
    """Name of the rl-zoo."""
    file: str
    """Name of the shipped hyperparameter file."""
    network: Literal["flat", "set", "posterior"] = "flat"
    """Layers on the flat observation, the set network, or that with a posterior of its own."""


LEARNERS = {
    "ppo": Learner(algorithm="ppo", file="ppo"),
    "ppo_lstm": Learner(algorithm="ppo_lstm", file="ppo_lstm"),
    "maskable_ppo": Learner(algorithm="maskable_ppo", file="maskable_ppo"),
    "ppo_set": Learner(algorithm="ppo", file="ppo_set", network="set"),
    "maskable_ppo_set": Learner(algorithm="maskable_ppo", file="ppo_set", network="set"),
    "ppo_joint": Learner(algorithm="ppo", file="ppo_joint", network="posterior"),
}
"""Learners by name."""


@dataclass(frozen=True, kw_only=True)
class Job:
    """Training of one learner with one seed."""

    learner: str
    """Name in `LEARNERS`."""
    env: str
    """Id of the environment."""
    env_kwargs: dict[str, Any]
    """Its arguments, which take precedence over the hyperparameter file's."""
    hyperparams: dict[str, Any]
    """Hyperparameters that override the file's."""
    seed: int
    """Seed of network and episodes."""
    steps: int
    """Steps in all; 0 for the file's."""
    seconds: float | None
    """Time in all [s]; None without limit."""
    out: str
    """Folder of the results."""
    device: str = "cpu"
    """Device of torch."""
    threads: int = 1
    """Threads of torch, and of the simulation in this process."""
    workers: int = 1
    """Processes that simulate the arms; 1 for this process alone."""
    evaluations: int = 12
    """Evaluations, the last one at the end."""
    eval_episodes: int = 200
    """Episodes of an evaluation."""
    last_episodes: int = 1000
    """Episodes of the last evaluation."""
    restart: bool = False
    """Forget what the folder holds."""
    command: str = ""
    """Command line, for the configuration."""


def run_folder(job: Job) -> Path:
    """Folder of a run: ``OUT/ENV/LEARNER/seed_K``."""
    return Path(job.out) / job.env.replace("/", "-") / job.learner / f"seed_{job.seed}"


def train_end_to_end(job: Job, say: Callable[[str], None] = print) -> Path:
    """Train or resume a run until its budget is spent; return its folder.

    The same job goes on from its last checkpoint. With a limit of steps alone and a CPU as device,
    same seed, same curve, for any number of workers; a limit of time depends on the machine.

    Raises
    ------
    InvalidSetting
        If the folder holds a run with another configuration, or the settings are refused.
    InvalidData
        If the checkpoint cannot be read.
    UnknownName
        If there is no such learner, environment or hyperparameter.
    ChildProcessError
        If a worker dies.
    """
    learner = _learner(job.learner)
    given = read_hyperparameters(HYPERPARAMETERS / f"{learner.file}.yml", job.env)
    given |= job.hyperparams
    arguments = given.pop("env_kwargs", {}) | {"threads": job.threads} | job.env_kwargs
    steps = job.steps or whole(given.get("n_timesteps", 0), "n_timesteps")
    if steps < 1:
        raise InvalidSetting(f"{learner.file}.yml has no n_timesteps: give the number of steps")
    model_kwargs = model_arguments(given, learner.algorithm)
    model_class = algorithm_named(learner.algorithm)

    import torch
    from stable_baselines3.common.logger import Logger

    from loose_agents.rl.checkpoint import TRAINED_ON
    from loose_agents.rl.end_to_end.learning_curve import Budget, BudgetSchedule

    torch.set_num_threads(job.threads)
    num_envs = whole(given.get("n_envs", 1), "n_envs")
    env = make_environments(job.env, num_envs if job.workers == 1 else 1, arguments)
    problem = Problem.of(env.arm, env.settings)
    configuration = _configuration(job, learner, given, arguments, problem, steps)
    folder = run_folder(job)
    budget = Budget(steps=steps, seconds=job.seconds)
    for name in ("learning_rate", "clip_range"):
        if isinstance(model_kwargs.get(name), LinearSchedule):
            model_kwargs[name] = BudgetSchedule(model_kwargs[name], budget)
    if learner.network != "flat":
        model_kwargs |= _set_network(learner, env.layout, problem, model_kwargs)
    model_kwargs |= _rollout_buffer(learner)
    vec = _environments(job, learner, env, arguments, num_envs)
    try:
        model = model_class(env=vec, seed=job.seed, device=job.device, **model_kwargs)
        setattr(model, TRAINED_ON, problem.fingerprint)
        model.set_logger(Logger(None, []))
        true_arm = env.batch.true_arm
        _learn(job, learner, model, vec, budget, problem, true_arm, configuration, say)
    finally:
        vec.close()
    return folder


def _learn(
    job: Job,
    learner: Learner,
    model: Any,
    vec: Any,
    budget: Any,
    problem: Problem,
    true_arm: Arm,
    configuration: dict[str, Any],
    say: Callable[[str], None],
) -> None:
    """Train a model, from its checkpoint if there is one, until the budget is spent."""
    from loose_agents.rl.end_to_end.evaluation import evaluate_policy
    from loose_agents.rl.end_to_end.learning_curve import BudgetSchedule, CurveCallback, CurveState
    from loose_agents.rl.training_env import training_seed
    from loose_agents.rl.training_run import write_json

    folder = run_folder(job)
    name = f"{job.env} {job.learner} seed {job.seed}"
    resumed = (folder / "checkpoint.zip").is_file() and not job.restart
    if resumed:
        model.run_state = _restored(folder, model, configuration, CurveState)
        say(f"{name}: resumed at {model.num_timesteps} steps")
    else:
        model.run_state = CurveState()
    state = model.run_state
    over = job.seconds is not None and state.seconds >= job.seconds
    if over or model.num_timesteps >= budget.steps:
        say(f"{name}: trained already, {model.num_timesteps} steps in {state.seconds:.0f} s")
        return
    folder.mkdir(parents=True, exist_ok=True)
    if not resumed:  # no checkpoint of another configuration beside the new one
        for name in ("checkpoint.zip", "curve.csv"):
            (folder / name).unlink(missing_ok=True)
    write_json(folder / "configuration.json", configuration)
    budget.begin(state.seconds)
    vec.seed(training_seed(job.seed, model.num_timesteps))
    if learner.network != "flat" and not resumed:
        state.records += _standardise(model, vec, job.seed, problem.settings.max_records)
    state.restore_generators()
    callbacks: list[Any] = []
    if learner.network == "posterior":
        from loose_agents.rl.end_to_end.joint_inference import InferenceCallback

        rate = BudgetSchedule(LinearSchedule(_INFERENCE_RATE), budget)
        callbacks.append(InferenceCallback(vec, problem.hypotheses, rate=rate, seed=job.seed))
    curve = CurveCallback(
        folder,
        budget,
        lambda episodes: evaluate_policy(model, problem, episodes, job.threads, true_arm),
        evaluations=job.evaluations,
        episodes=job.eval_episodes,
        last_episodes=job.last_episodes,
        show=lambda point: say(
            f"{name}: {point.steps} steps, {point.records} records, {point.seconds:.0f} s: "
            f"return {point.mean_return:+.3f}, right {point.right:.3f}, unsure "
            f"{point.unsure:.3f}, {point.records_per_episode:.2f} records an episode"
        ),
    )
    model.learn(
        budget.steps - model.num_timesteps,
        callback=[*callbacks, curve],
        reset_num_timesteps=not resumed,
    )


def _environments(
    job: Job, learner: Learner, env: Any, arguments: dict[str, Any], num_envs: int
) -> Any:
    """Environments of the rollouts, simulated here or by workers."""
    from loose_agents.rl.end_to_end.joint_inference import ConcurrentVecEnv
    from loose_agents.rl.end_to_end.parallel_env import ParallelVecEnv
    from loose_env.envs.sb3 import Sb3VecEnv

    vec = (
        Sb3VecEnv(env)
        if job.workers == 1
        else ParallelVecEnv(env, job.env, arguments, num_envs=num_envs, workers=job.workers)
    )
    return ConcurrentVecEnv(vec) if learner.network == "posterior" else vec


def _rollout_buffer(learner: Learner) -> dict[str, Any]:
    """Argument of an algorithm whose rollouts lie on its device; that of RecurrentPPO is fixed."""
    from loose_agents.rl.end_to_end.device_buffer import (
        DeviceMaskableRolloutBuffer,
        DeviceRolloutBuffer,
    )

    kinds = {"ppo": DeviceRolloutBuffer, "maskable_ppo": DeviceMaskableRolloutBuffer}
    kind = kinds.get(learner.algorithm)
    return {} if kind is None else {"rollout_buffer_class": kind}


def _set_network(
    learner: Learner, layout: Any, problem: Problem, model_kwargs: dict[str, Any]
) -> dict[str, Any]:
    """Arguments of an algorithm whose policy has a set network before its layers."""
    from loose_agents.rl.end_to_end.joint_inference import PosteriorPolicy, PosteriorSetExtractor
    from loose_agents.rl.end_to_end.record_set import RecordSetExtractor, record_set_arguments

    own = dict(model_kwargs.get("policy_kwargs") or {})
    given = {**record_set_arguments(layout), **own.pop("features_extractor_kwargs", {})}
    kind: Any = RecordSetExtractor
    changed: dict[str, Any] = {}
    if learner.network == "posterior":
        kind, given = PosteriorSetExtractor, {**given, "hypotheses": len(problem.hypotheses)}
        changed["policy"] = PosteriorPolicy
        prices, names = problem.settings.prices, problem.hypotheses
        own["verdict_rewards"] = [
            [prices.verdict(named, truth) for truth in names] for named in (*names, UNSURE)
        ]
    changed["policy_kwargs"] = {
        **own,
        "features_extractor_class": kind,
        "features_extractor_kwargs": given,
    }
    return changed


def _learner(name: str) -> Learner:
    if name not in LEARNERS:
        raise UnknownName(f"unknown learner {name!r}; learners are {list(LEARNERS)}")
    return LEARNERS[name]


def _configuration(
    job: Job,
    learner: Learner,
    hyperparameters: dict[str, Any],
    arguments: dict[str, Any],
    problem: Problem,
    steps: int,
) -> dict[str, Any]:
    """Everything that the result depends on."""
    from loose_agents.rl.training_run import with_versions

    not_compared = {k: v for k, v in arguments.items() if k != "threads"}
    found = {
        "format": "loose-learning-curve/1",
        "learner": {"name": job.learner, **asdict(learner)},
        "env": job.env,
        "env_kwargs": not_compared,
        "arm": problem.arm.name,
        "hypotheses": problem.hypotheses,
        "seed": job.seed,
        "hyperparameters": {k: v for k, v in hyperparameters.items() if k != "n_timesteps"},
        "settings": asdict(problem.settings),
        "evaluation": {"seed": CURVE_SEED, "episodes": job.eval_episodes},
        "n_timesteps": steps,
        "options": asdict(job),
        "command": job.command,
    }
    return with_versions(found, Path(__file__).resolve().parents[4])


def _restored(folder: Path, model: Any, configuration: dict[str, Any], kind: type[Any]) -> Any:
    """Load the state that a run goes on with."""
    from loose_agents.rl.checkpoint import read_model, restore
    from loose_agents.rl.training_run import RunFolder, differences

    differ = differences(RunFolder(folder).described(), configuration)
    if differ:
        raise InvalidSetting(
            f"{folder} holds a run with other {', '.join(differ)}; choose another --out, or "
            "--restart to begin anew"
        )
    checkpoint = folder / "checkpoint.zip"
    try:
        return restore(read_model(checkpoint, str(model.device)), model, kind)
    except InvalidData as error:
        raise InvalidData(
            f"cannot go on from {checkpoint}; --restart begins anew: {error}"
        ) from error


def _standardise(model: Any, vec: Any, seed: int, max_records: int) -> int:
    """Standardise the set network's input on the records of random actions; return their number."""
    rng = np.random.default_rng(seed)
    choices = vec.action_space.nvec
    observation = vec.reset()
    taken = 0
    for _ in range(min(_STANDARDISING_STEPS, max_records)):
        actions = rng.integers(0, choices, size=(vec.num_envs, len(choices)))
        actions[:, -1] = 0  # no verdict
        observation, _, _, _ = vec.step(actions)
        taken += vec.num_envs
    model.policy.features_extractor.standardise(observation)
    return taken
