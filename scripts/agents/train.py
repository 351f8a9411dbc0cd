"""Train a policy on an environment, with the options of the rl-zoo.

Usage: python scripts/agents/train.py --algo ppo --env loose_env/Vera-v0 -P

The run lies in LOG_FOLDER/ALGO/ENV_SEED. The same command run again goes on from the last
checkpoint, also after a kill; scripts/agents/enjoy.py plays what it learned. `--export FOLDER`
puts the best policy elsewhere, such as agents/loose_agents/weights/vera.
"""

from __future__ import annotations

import argparse
import importlib
import shutil
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from loose_agents.base import Problem
from loose_agents.belief import feature_size, make_estimator
from loose_agents.evaluation import evaluate, make_environments
from loose_agents.execution.progress import ProgressLine
from loose_agents.execution.script_errors import errors_in_one_line
from loose_agents.rl.hyperparameters import (
    ALGORITHMS,
    algorithm_named,
    key_values,
    model_arguments,
    read_hyperparameters,
    shipped_file,
    whole,
)
from loose_agents.rl.training_options import check_training, training_parser

from loose_env.envs import ActionLayout, DiagnosisVectorEnv
from loose_env.errors import InvalidData, InvalidSetting, MissingExtra

ROOT = Path(__file__).resolve().parents[2]
STOP_BIAS = -1.5
"""Added to the logit of stopping at the start: early verdicts are mostly wrong, teach little."""
LEVEL_BIAS = 2.5
"""Added at the start to the logits of each joint's top level and of the last record length."""


def configuration_of(
    options: argparse.Namespace,
    problem: Problem,
    arguments: dict[str, Any],
    hyperparameters: dict[str, Any],
    steps: int,
    further: int,
) -> dict[str, Any]:
    """Everything that the result depends on."""
    from loose_agents.rl.network import FORMAT
    from loose_agents.rl.training_run import with_versions

    own = {key: value for key, value in hyperparameters.items() if key != "n_timesteps"}
    found = {
        "format": FORMAT,
        "algorithm": ALGORITHMS[options.algo][0],
        "env": options.env,
        "env_kwargs": arguments,
        "arm": problem.arm.name,
        "hypotheses": problem.hypotheses,
        "estimator": options.estimator,
        "further_features": further,
        "seed": options.seed,
        "n_timesteps": steps,
        "hyperparameters": own,
        "training": {
            "shaping": options.shaping,
            "forced_records": options.forced_records,
            "forced_share": options.forced_share,
            "eval_episodes": options.eval_episodes,
            "trained_agent": options.trained_agent,
        },
        "settings": asdict(problem.settings),
        "options": vars(options),
        "command": " ".join(sys.argv),
    }
    return with_versions(found, ROOT)


def train(options: argparse.Namespace) -> Path:
    """Train, keep the run on disk, and return its folder."""
    check_training(options)
    for package in options.gym_packages:
        importlib.import_module(package)
    algorithm = ALGORITHMS[options.algo][0]
    hyperparameters = read_hyperparameters(
        options.conf_file or shipped_file(options.algo), options.env
    ) | key_values(options.hyperparams, "--hyperparams")
    own = hyperparameters.pop("env_kwargs", {})
    if not isinstance(own, dict):
        raise InvalidSetting(f"env_kwargs in a hyperparameter file is a mapping, got {own!r}")
    arguments = own | key_values(options.env_kwargs, "--env-kwargs")
    model_class = algorithm_named(algorithm)
    given = model_arguments(hyperparameters, algorithm)  # fails here, before anything is made
    steps = whole(hyperparameters.get("n_timesteps", 0), "n_timesteps")
    if options.n_timesteps > 0:
        steps = options.n_timesteps
    if steps < 1:
        raise InvalidSetting("the hyperparameters have no n_timesteps: give -n")

    import torch
    from loose_agents.rl.checkpoint import TRAINED_ON
    from loose_agents.rl.training_env import TrackedVecEnv, evaluation_seed, training_seed
    from loose_agents.rl.training_run import RunCallback, RunFolder, RunState, Schedule, write_json
    from stable_baselines3.common.logger import Logger

    torch.set_num_threads(max(options.num_threads, 1))
    num_envs = whole(hyperparameters.get("n_envs", 1), "n_envs")
    env = make_environments(options.env, num_envs, arguments)
    problem = Problem.of(env.arm, env.settings)
    estimator = make_estimator(options.estimator, problem)
    configuration = configuration_of(
        options, problem, arguments, hyperparameters, steps, feature_size(estimator)
    )
    name = options.env.replace("/", "-")
    folder = RunFolder(Path(options.log_folder) / algorithm / f"{name}_{options.seed}")
    folder.root.mkdir(parents=True, exist_ok=True)
    vec = TrackedVecEnv(env, problem, estimator, shaping=options.shaping)
    log = str(Path(options.tensorboard_log) / name) if options.tensorboard_log else None
    given |= {"tensorboard_log": log, "seed": options.seed, "device": options.device}
    resumed = folder.checkpoint.is_file() and not options.restart
    if resumed:
        model = checkpointed(folder, configuration, model_class, vec, given, problem)
        say(options, f"resumed from {folder.checkpoint} at {model.num_timesteps} steps")
    else:
        check_elsewhere(options.trained_agent, folder)
        model = new_model(model_class, vec, given, options.trained_agent, problem)
        model.run_state = RunState()
        folder.clear()  # only now: what was refused has taken nothing away
    setattr(model, TRAINED_ON, problem.fingerprint)
    if model.num_timesteps >= steps:
        say(options, f"{folder.root} is trained already, {model.num_timesteps} steps")
    else:
        write_json(folder.configuration, configuration)
        first = training_seed(options.seed, model.num_timesteps)
        vec.seed(first)
        model.run_state.restore_generators()
        show, close = progress(options, steps, model.num_timesteps)
        callback = RunCallback(
            folder,
            vec,
            Schedule(
                total=steps,
                save_freq=options.save_freq,
                eval_freq=options.eval_freq,
                forced=options.forced_records,
                forced_share=options.forced_share,
            ),
            configuration,
            evaluator(options, problem, estimator, env, evaluation_seed(options.seed)),
            show,
        )
        if log is None:
            model.set_logger(Logger(None, []))  # its own would leave an empty folder in /tmp
        try:
            model.learn(
                steps - model.num_timesteps,
                callback=callback,
                tb_log_name=f"{algorithm}_{options.seed}",
                reset_num_timesteps=not resumed,
            )
        finally:
            close()
            vec.close()
    say(options, f"policy: {folder.root}")
    if options.export:
        export(folder, Path(options.export))
        say(options, f"exported to {options.export}")
    return folder.root


def checkpointed(
    folder: Any,
    configuration: dict[str, Any],
    model_class: type[Any],
    vec: Any,
    given: dict[str, Any],
    problem: Problem,
) -> Any:
    """Load the model that a run goes on with; nothing in the file is run.

    Raises
    ------
    InvalidSetting
        If the run has another configuration, with what differs.
    InvalidData
        If the checkpoint cannot be read.
    """
    from loose_agents.rl.checkpoint import network_arguments, read_model, restore
    from loose_agents.rl.training_run import RunState, differences

    before = folder.described()
    differ = differences(before, configuration)
    if differ:
        raise InvalidSetting(
            f"{folder.root} holds a run with other {', '.join(differ)}; choose another "
            "--log-folder or --seed, or --restart to begin anew"
        )
    for name in ("versions", "git_commit"):
        if before.get(name) != configuration[name]:
            print(f"train: note: {name} differs from that of the run's start", file=sys.stderr)
    try:
        stored = read_model(folder.checkpoint, given["device"])
        # Made with the options of the run, which are those of its start: only tensors, counts and
        # the states of generators come from the file. A run that continued a model has its network.
        if configuration["training"]["trained_agent"]:
            given = given | {"policy_kwargs": network_arguments(stored)}
        model = new_model(model_class, vec, given, "", problem)
        model.run_state = restore(stored, model, RunState)
    except InvalidData as error:
        raise InvalidData(
            f"cannot go on from {folder.checkpoint}; --restart begins anew: {error}"
        ) from error
    return model


def check_elsewhere(path: str, folder: Any) -> None:
    """Refuse to continue a model in its own folder, which is cleared.

    Raises
    ------
    InvalidSetting
        If it lies there.
    """
    if path and folder.root.resolve() in Path(path).resolve().parents:
        raise InvalidSetting(
            f"{path} lies in the folder of the run itself; choose another --log-folder or --seed "
            "for the run that continues it"
        )


def new_model(
    model_class: type[Any], vec: Any, given: dict[str, Any], path: str, problem: Problem
) -> Any:
    """Make a model, or load the one that is to be continued.

    Raises
    ------
    InvalidSetting
        If the algorithm refuses its hyperparameters, or the model does not fit.
    """
    try:
        if not path:
            model = model_class(env=vec, **given)
            _start_from_shaking_all(model, problem.actions)
            return model
        from loose_agents.rl.checkpoint import network_arguments, put_parameters, read_model

        # The network stays as it is; what remains are the settings of the algorithm.
        stored = read_model(path, given["device"])
        model = model_class(env=vec, **given | {"policy_kwargs": network_arguments(stored)})
        put_parameters(stored, model)
        return model
    except ImportError as error:
        raise MissingExtra(f"{error}; pip install -e '.[train]' installs it") from error
    except (AssertionError, TypeError, ValueError, KeyError, RuntimeError) as error:
        what = f"cannot continue {path}" if path else "hyperparameters refused"
        reason = " ".join(str(error).split())
        raise InvalidSetting(f"{what} by {model_class.__name__}: {reason}") from error


def _start_from_shaking_all(model: Any, actions: ActionLayout) -> None:
    """Start with a policy that mostly shakes at the top level for long, and seldom stops.

    All joints where the rules let all be excited, else any of them. That is the constant policy;
    what is learned is where to depart from it.
    """
    import torch

    with torch.no_grad():
        bias = model.policy.action_net.bias
        bias[torch.as_tensor(actions.strongest_options())] += LEVEL_BIAS
        bias[-1] += STOP_BIAS


def evaluator(
    options: argparse.Namespace,
    problem: Problem,
    estimator: Any,
    env: DiagnosisVectorEnv,
    seed: int,
) -> Callable[[Any], Any]:
    """Return what plays the evaluation episodes, the same every time, with a network."""
    from loose_agents.rl.learned_policy import LearnedAgent

    def play(network: Any) -> Any:
        return evaluate(
            LearnedAgent(problem, network, estimator),
            "policy",
            problem.arm,
            problem.settings,
            episodes=options.eval_episodes,
            seed=seed,
            width=options.n_eval_envs,
            threads=env.batch.threads,
            true_arm=env.batch.true_arm,
        )

    return play


def progress(
    options: argparse.Namespace, total: int, start: int
) -> tuple[Callable[[int, str], None], Callable[[], None]]:
    """Return what shows how far the training is, and what ends the showing."""
    begin = time.perf_counter()
    if not options.progress:

        def line(steps: int, words: str) -> None:
            spent = time.perf_counter() - begin
            say(options, f"{steps:7d} of {total} steps  {spent:5.0f} s  {words}")

        return line, lambda: None
    bar = ProgressLine(total, done=start, unit="steps")

    def move(steps: int, words: str) -> None:
        bar.advance(steps - bar.n, words)

    return move, bar.close


def export(folder: Any, target: Path) -> None:
    """Copy the best policy, or the last if none was evaluated, weights last."""
    from loose_agents.rl.learned_policy import CONFIGURATION
    from loose_agents.rl.network import WEIGHTS

    source = folder.best if (folder.best / WEIGHTS).is_file() else folder.root
    target.mkdir(parents=True, exist_ok=True)
    for name in (CONFIGURATION, WEIGHTS):
        beside = target / (name + ".part")
        shutil.copyfile(source / name, beside)
        beside.replace(target / name)


def say(options: argparse.Namespace, words: str) -> None:
    """Print, unless nothing is to be printed."""
    if options.verbose:
        print(words, flush=True)


def main(arguments: Sequence[str] | None = None) -> None:
    """Read the options and train, with errors in one line."""
    options = training_parser(__doc__).parse_args(arguments)
    going_on = "the same command goes on from the last checkpoint"
    with errors_in_one_line("train", interrupted=going_on):
        train(options)


if __name__ == "__main__":
    main()
