"""Agents that play trained policies: exported ones, and model files of stable-baselines3.

A policy on a posterior chooses a move and a level for every joint, the record length, and when to
stop. What it names then is the verdict that is worth most under the posterior, or nothing where the
records are unlike all that the posterior was made for.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from loose_agents.base import EpisodeAgent, Problem
from loose_agents.belief import (
    BeliefAgent,
    Situation,
    StoppingRule,
    Tracker,
    best_verdict,
    make_estimator,
    records_measured,
    verdict_of,
)
from loose_agents.rl.model_files import (
    TRAINED_ON,
    StoredModel,
    activation_of,
    one_line,
    read_model,
)
from loose_agents.rl.networks import (
    FORMAT,
    PolicyNetwork,
    choices_of,
    input_size,
    load_network,
    network_from_tensors,
)
from loose_env.envs import DiagnosisVectorEnv
from loose_env.errors import InvalidData, UnknownName
from loose_env.wrappers import posterior_bounds, posterior_features, vector

CONFIGURATION = "configuration.json"
"""File that says how a policy was trained, beside its weights."""

WRAPPERS = ("MeasuredMinusNominal", "JointSideObservation", "MacroActions")
"""Wrappers that a policy may be trained within: those that keep no state of an episode."""

_ONE = np.array([0])

FURTHER_BOUND = 5.0
"""Bound of an estimator's features beside its probabilities, either sign."""


class PolicyForm:
    """Observation and action encoding of the learned policy.

    It sees the `loose_env.wrappers.posterior_features`, then what else the estimator has to show.

    It chooses moves, levels and a record length by the entries of the environment's action, and
    in place of the verdict whether to stop.
    """

    def __init__(self, problem: Problem, further: int = 0) -> None:
        self.problem, self.further = problem, further
        self.nvec = np.append(problem.actions.nvec[:-1], 2)
        kinds = len(problem.hypotheses)
        start = problem.layout.global_elements
        bounds = [
            *posterior_bounds(kinds, start),
            *[(-FURTHER_BOUND, FURTHER_BOUND)] * further,
        ]
        low, high = np.array(bounds, dtype=np.float32).T
        self.observation_space = spaces.Box(low, high, dtype=np.float32)
        self.action_space = spaces.MultiDiscrete(self.nvec)

    def features(
        self,
        observation: NDArray[np.float32],
        probabilities: NDArray[np.float64],
        further: NDArray[np.float32] | None = None,
    ) -> NDArray[np.float32]:
        """Observation of the policy (features,)."""
        start = observation[: len(self.problem.layout.global_elements)]
        shown = np.zeros(0) if further is None else np.asarray(further, dtype=float)
        if shown.shape != (self.further,):
            raise InvalidData(
                f"the estimator said that it shows {self.further} numbers, it showed {shown.shape}"
            )
        found = np.concatenate([posterior_features(probabilities, start), shown])
        space = self.observation_space
        return np.asarray(np.clip(found.astype(np.float32), space.low, space.high))

    def stops(self, choice: NDArray[np.int64], records: int, *, least: int = 1) -> bool:
        """Return True if a choice ends the episode, within the record limits."""
        most = self.problem.settings.max_records
        return records >= most or (bool(choice[-1]) and records >= min(max(least, 1), most))

    def action(
        self,
        choice: NDArray[np.int64],
        probabilities: NDArray[np.float64],
        records: int,
        measured: int | None = None,
        *,
        least: int = 1,
    ) -> NDArray[np.int64]:
        """Convert a choice to an action of the environment.

        Arguments as in `stops`; ``measured`` is the number of records that are not empty, by
        default all.
        """
        if self.stops(choice, records, least=least):
            unsure = self.problem.actions.allows_unsure(
                records, records if measured is None else measured
            )
            return self.problem.verdict(best_verdict(self.problem, probabilities, unsure=unsure))
        return self.measuring(choice)

    def measuring(self, choice: NDArray[np.int64]) -> NDArray[np.int64]:
        """Convert a choice to a measurement action, ignoring its stop decision."""
        return np.append(np.asarray(choice, dtype=np.int64)[:-1], 0)

    def mask(
        self,
        pose: NDArray[np.float64],
        records: int,
        measured: int | None = None,
        *,
        least: int = 1,
    ) -> NDArray[np.bool_]:
        """Mask of valid options, choice by choice (options,).

        No move past the range of a joint, no stop before ``least`` records, no going on after
        the last.
        """
        actions, most = self.problem.actions, self.problem.settings.max_records
        last = records >= most
        stop = last or records >= min(max(least, 1), most)
        shown = records if measured is None else measured
        measuring = actions.mask(pose, records, shown)[: int(self.nvec[:-1].sum())]
        return np.concatenate([measuring, [not last, stop]])


class LearnedAgent(BeliefAgent):
    """Plays a trained policy."""

    estimator: Tracker

    def __init__(
        self,
        problem: Problem,
        network: PolicyNetwork,
        estimator: Tracker | None = None,
        stopping: StoppingRule | None = None,
        *,
        seed: int = 0,
    ) -> None:
        made = make_estimator("posterior", problem) if estimator is None else estimator
        super().__init__(problem, made, None, stopping, seed=seed)
        self.form = PolicyForm(problem, made.feature_size)
        self.network = network

    @classmethod
    def load(cls, problem: Problem, folder: str | Path) -> LearnedAgent:
        """Load the weights that `scripts/agents/train.py` wrote."""
        where = Path(folder)
        described = described_run(where)
        found, arm = described.get("format"), described.get("arm")
        if found != FORMAT:
            raise InvalidData(
                f"{where} holds a policy of format {found!r:.60}, this version reads {FORMAT!r}; "
                f"train it anew with scripts/agents/train.py --export {where}"
            )
        if arm != problem.arm.name:
            raise InvalidData(f"{where} was trained for arm {arm!r:.60}, not {problem.arm.name!r}")
        estimator = make_estimator(str(described.get("estimator", "posterior")), problem)
        form = PolicyForm(problem, estimator.feature_size)
        return cls(problem, load_network(where, form), estimator)

    def decide(self, situation: Situation) -> NDArray[np.int64]:
        """Evaluate the policy."""
        problem, form, now = self.problem, self.form, situation
        observation = now.observation
        further = self.estimator.features(observation, now.memory)
        choice = self.network.choose(
            form.features(observation, now.probabilities, further),
            form.mask(now.pose, now.records, records_measured(problem, observation)),
        )
        if self.stopping is None:
            done = form.stops(choice, now.records)
        else:
            done = now.records > 0 and (
                now.records >= problem.settings.max_records or self.stopping.stop(now)
            )
        named = verdict_of(problem, now, self.surprising) if done else None
        return form.measuring(choice) if named is None else problem.verdict(named)


def wrapped(env: Any, wrappers: Sequence[str]) -> Any:
    """A batch within some of the `WRAPPERS`, the first innermost."""
    for name in wrappers:
        if name not in WRAPPERS:
            raise UnknownName(f"unknown wrapper {name!r:.60}; wrappers are {list(WRAPPERS)}")
        env = getattr(vector, name)(env)
    return env


def layout_of(env: Any) -> Any:
    """Layout of what a batch shows, within wrappers or not."""
    return env.layout if hasattr(env, "layout") else env.of_inner("layout")


class ModelAgent(EpisodeAgent):
    """Plays a policy trained on the environment's own records, as its wrappers show them."""

    def __init__(
        self,
        problem: Problem,
        network: PolicyNetwork,
        wrappers: Sequence[str] = (),
        *,
        seed: int = 0,
    ) -> None:
        super().__init__(problem, seed=seed)
        self.network = network
        shell = wrapped(DiagnosisVectorEnv(problem.arm, problem.settings, num_envs=1), wrappers)
        self._space = shell.single_action_space
        self._changes: list[Any] = []
        while shell is not shell.unwrapped:
            self._changes.insert(0, shell)
            shell = shell.env

    def begin(self, rng: np.random.Generator) -> Any:
        """Return the initial state of an episode: none is kept."""

    def act(self, observation: NDArray[np.float32], memory: Any) -> NDArray[np.int64]:
        """Evaluate the policy."""
        problem = self.problem
        mask = problem.actions.mask(
            problem.layout.pose_of(observation),
            problem.layout.records_of(observation),
            records_measured(problem, observation),
        )
        shown, mask = observation[None], mask[None]
        for change in self._changes:
            shown, mask = change.shown(shown, _ONE), change.masks(mask)
        choice: NDArray[np.int64] = self.network.choose(shown[0], mask[0])
        choice = choice.reshape(1, *self._space.shape)
        for change in reversed(self._changes):
            choice = change.inner_actions(choice)
        return np.asarray(choice[0])


def model_agent(path: str | Path, problem: Problem, *, seed: int = 0) -> EpisodeAgent:
    """Make an agent of a model file: of the rl-zoo, of one's own training, or of train.py.

    What it was trained on shows in the size of its input: the environment's observation, or that
    of `PolicyForm` on a posterior. Which posterior says ``configuration.json`` beside the file.
    The arm is told by the file itself where this package trained it, else by the file beside it;
    of a model that has neither only the sizes are checked. No code of the file is run.
    """
    stored = read_model(path)
    folder = stored.path.parent
    beside = described_run(folder) if (folder / CONFIGURATION).is_file() else {}
    _require_same_problem(stored, beside, problem)
    tensors = stored.parameters["policy"]
    try:
        seen = input_size(tensors)
    except (KeyError, IndexError) as error:
        raise InvalidData(f"{stored.path}: only MlpPolicy is read, on a set network too") from error
    layout = problem.layout
    wrappers = beside.get("wrappers", [])
    if wrappers or seen is None or seen == layout.size:
        shell = wrapped(DiagnosisVectorEnv(problem.arm, problem.settings, num_envs=1), wrappers)
        made = _network(stored, problem, choices_of(shell.single_action_space), layout_of(shell))
        return ModelAgent(problem, made, wrappers, seed=seed)
    estimator = make_estimator(str(beside.get("estimator", "posterior")), problem)
    form = PolicyForm(problem, estimator.feature_size)
    sees = form.observation_space.shape[0]
    if seen != sees:
        raise InvalidData(
            f"{path} sees {seen} numbers; the observation of arm {problem.arm.name!r} has "
            f"{layout.size}, and that on a posterior {sees}: it was trained on another arm, other "
            "settings or through a wrapper"
        )
    network = _network(stored, problem, form.nvec)
    return LearnedAgent(problem, network, estimator, seed=seed)


def _network(
    stored: StoredModel, problem: Problem, nvec: NDArray[np.int64], layout: Any = None
) -> PolicyNetwork:
    """Actor of a model file."""
    kind = stored.described.get("policy_class")
    module = kind.get("__module__", "") if isinstance(kind, dict) else ""
    try:
        return network_from_tensors(
            stored.parameters["policy"],
            nvec,
            activation=activation_of(stored),
            masked="maskable" in str(module),
            layout=problem.layout if layout is None else layout,
        )
    except (KeyError, IndexError, ValueError, RuntimeError) as error:
        raise InvalidData(
            f"{stored.path} holds no policy of this kind for arm {problem.arm.name!r}: "
            f"{type(error).__name__}: {error!s:.200}"
        ) from error


def _require_same_problem(stored: StoredModel, beside: dict[str, Any], problem: Problem) -> None:
    """Refuse a model of another arm or other spaces, whose sizes may be the same."""
    trained_on = stored.described.get(TRAINED_ON, problem.fingerprint)
    arm = beside.get("arm", problem.arm.name)
    if trained_on != problem.fingerprint or arm != problem.arm.name:
        raise InvalidData(
            f"{stored.path} was trained on {arm!r:.60}, fingerprint {trained_on!r:.20}, not on arm "
            f"{problem.arm.name!r} under these rules, fingerprint {problem.fingerprint!r}; play it "
            "with the environment and the arguments of its training"
        )


def described_run(folder: Path) -> dict[str, Any]:
    """Configuration of a run or of an exported policy."""
    path = folder / CONFIGURATION
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise InvalidData(
            f"no trained policy in {folder}: {path.name} cannot be read ({one_line(error)}); "
            f"scripts/agents/train.py --export {folder} writes one"
        ) from error
    if not isinstance(found, dict):
        raise InvalidData(f"{path} must hold a JSON object")
    return found
