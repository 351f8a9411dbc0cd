"""Evaluation of an agent: environments made by name, episodes played by seed, a row for each."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

import loose_env  # noqa: F401  (registers the ids)
from loose_agents.base import Agent, Problem, code_of
from loose_agents.belief import best_verdict, goes_on
from loose_env.arms import Arm
from loose_env.envs import (
    BatchRig,
    DiagnosisEnv,
    DiagnosisSettings,
    DiagnosisVectorEnv,
    EnvBatch,
)
from loose_env.errors import InvalidSetting, UnknownName
from loose_env.evaluation import fault_parameters
from loose_env.registration import IDS, TIERS


def arguments_of(text: str) -> dict[str, Any]:
    """Parse the environment's arguments from the option ``--arguments``."""
    try:
        found = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InvalidSetting(
            f"--arguments must be JSON such as '{{\"n_links\": 3}}': {error}"
        ) from error
    if not isinstance(found, dict):
        raise InvalidSetting(f"--arguments must be a JSON object, got {text!r:.100}")
    return found


def diagnosis_env(
    env_id: str, arguments: Mapping[str, Any], *, render_mode: str | None = None
) -> DiagnosisEnv:
    """Make the environment without Gymnasium's checking wrappers.

    Parameters
    ----------
    env_id : str
        Its id.
    arguments : mapping
        Its arguments.
    render_mode : str, optional
        How it draws itself.

    Raises
    ------
    UnknownName
        If it is no diagnosis environment.
    InvalidSetting
        If it does not take the arguments.
    gymnasium.error.Error
        If there is no such id.

    Examples
    --------
    >>> diagnosis_env("loose_env/Planar-v0", {"n_links": 3}).arm.n
    3
    """
    drawn = {} if render_mode is None else {"render_mode": render_mode}
    found: DiagnosisEnv = _made(gymnasium.make, env_id, {**drawn, **arguments})
    return found


def _made(make: Callable[..., Any], env_id: str, arguments: Mapping[str, Any]) -> Any:
    """A diagnosis environment or a batch; arguments that it does not take are named."""
    try:
        env = make(env_id, **arguments).unwrapped
    except (TypeError, OverflowError) as error:
        # Gymnasium adds the arguments once more.
        reason = " ".join(str(error).split()).partition(" was raised from the environment")[0]
        raise InvalidSetting(
            f"{env_id} does not take {dict(arguments)!s:.300}: {reason}"
        ) from error
    if not isinstance(env, (DiagnosisEnv, DiagnosisVectorEnv)):
        known = ", ".join((*IDS, *TIERS))
        raise UnknownName(f"{env_id} is no diagnosis environment; those are {known}")
    return env


def problem_of(env_id: str, arguments: Mapping[str, Any]) -> Problem:
    """Problem that an environment poses, by making it once."""
    env = diagnosis_env(env_id, arguments)
    return Problem.of(env.arm, env.settings)


def make_environments(env_id: str, num_envs: int, arguments: dict[str, Any]) -> DiagnosisVectorEnv:
    """Make the environments side by side."""
    if env_id not in gymnasium.registry:
        raise UnknownName(f"unknown environment {env_id!r}; environments are {', '.join(IDS)}")
    env: DiagnosisVectorEnv = _made(gymnasium.make_vec, env_id, {"num_envs": num_envs, **arguments})
    if env.settings.raw:
        raise InvalidSetting("a policy learns on statistics, not on raw signals: leave raw out")
    return env


@dataclass(frozen=True, kw_only=True)
class EpisodeRow:
    """Outcome of one episode and its hidden fault.

    The trails have an entry for each record after which the agent was asked again, the first
    record first. Those of probabilities are empty for agents that keep none.
    """

    agent: str
    """Name of the agent."""
    seed: int
    """Seed of the episodes."""
    episode: int
    """Number of the episode; with the seed it fixes all that is hidden."""
    difficulty: str
    """Name of the difficulty; "own" for ranges without a name."""
    truth: str
    """The hypothesis that was true."""
    verdict: str | None
    """The one that was named."""
    success: bool
    """True if the two are the same."""
    link_success: bool
    """True if the verdict names the right link or joint, whatever the kind."""
    poses: int
    """Poses measured in."""
    records: int
    """Records taken."""
    seconds: float
    """Time of excitation [s]."""
    excited: int
    """Joints excited, counted anew in each record."""
    price: float
    """Cost of the records."""
    reward: float
    """Return: the verdict's reward less the price."""
    truncated: bool
    """True if the simulation diverged."""
    gap: float | None
    """Travel of the hidden seat [m, or rad where it turns]."""
    friction: float | None
    """Its Coulomb friction [N, or N·m where it turns]."""
    friction_ratio: float | None
    """Rms seat drive of the top level over the friction [1]; None on a healthy arm."""
    opening_ratio: float | None
    """The same over friction and gravity's load, in the best pose [1]; None on a healthy arm."""
    direction: tuple[float, float, float] | None
    """Direction of a slide or axis of a rocking link, link frame."""
    confidence: float | None
    """Probability of what was named, as the agent saw it."""
    truth_probability: float | None
    """Probability that the agent gave to the truth at the end."""
    actions: str = ""
    """Actions, the last one the verdict, in the form of `loose_agents.base.code_of`, with spaces
    between."""
    trail_best: tuple[str, ...] = ()
    """Most probable hypothesis after each record."""
    trail_confidence: tuple[float, ...] = ()
    """Its probability."""
    trail_truth: tuple[float, ...] = ()
    """Probability of the truth after each record."""
    trail_verdict: tuple[str, ...] = ()
    """Verdict that was worth most after each record."""
    trail_price: tuple[float, ...] = ()
    """Cost of the records so far."""
    trail_seconds: tuple[float, ...] = ()
    """Time of excitation so far [s]."""


@dataclass(kw_only=True, eq=False)
class _Run:
    """State of one episode in progress."""

    number: int
    state: Any = None
    begun: bool = False
    excited: int = 0
    price: float = 0.0
    verdict_reward: float = 0.0
    probabilities: NDArray[np.float64] | None = None
    trails: dict[str, list[Any]] = field(default_factory=lambda: defaultdict(list))
    actions: list[str] = field(default_factory=list)


def evaluate(
    agent: Agent,
    name: str,
    arm: Arm,
    settings: DiagnosisSettings,
    *,
    episodes: int,
    seed: int,
    first: int = 0,
    records: int | None = None,
    width: int = 64,
    threads: int = 0,
    rig: BatchRig | None = None,
    true_arm: Arm | None = None,
    options: Mapping[str, Any] | None = None,
    progress: Callable[[int], None] | None = None,
) -> list[EpisodeRow]:
    """Play episodes ``first`` to ``first + episodes - 1`` of a seed.

    Episode k hides the same fault in the same true arm for every agent, and goes the same way
    at any ``width`` (number of arms side by side) and thread count, and in whatever range.

    The agent is known by ``predict`` alone. A state that has ``probabilities`` of the hypotheses
    (hypotheses,) is read for the trails.

    Parameters
    ----------
    agent : Agent
        Who plays.
    name : str
        Its name in the rows.
    arm, settings : Arm, DiagnosisSettings
        The nominal arm and the rules.
    episodes, seed, first : int
        Which episodes.
    records : int, optional
        Make the agent take so many records, however sure it is: one run then tells by the trails
        how often it is right after 1, 2, ... records. See `goes_on`.
    width, threads : int
        Arms side by side, and simulation threads (0: all processors).
    rig : BatchRig, optional
        Where measurements come from.
    true_arm : Arm, optional
        The arm that is measured, where it is not the nominal one
        (`loose_env.envs.EnvBatch`). What is hidden in episode k then depends on it alone,
        whatever the nominal arm.
    options : mapping, optional
        Options of every episode, as `loose_env.envs.batch` has them.
    progress : callable, optional
        Called with the number of finished episodes.

    Raises
    ------
    InvalidSetting
        If there are no episodes, or the agent cannot be made to take ``records``.
    """
    if episodes < 1:
        raise InvalidSetting(f"episodes must be 1 or more, got {episodes}")
    if records is not None:
        if not 1 <= records <= settings.max_records:
            raise InvalidSetting(
                f"records must be 1 to {settings.max_records} (the settings' max_records), "
                f"got {records}"
            )
        agent = goes_on(agent, records)
    width = min(width, episodes)
    batch = EnvBatch(arm, settings, num=width, threads=threads, rig=rig, true_arm=true_arm)
    rows: dict[int, EpisodeRow] = {}
    running: dict[int, _Run] = {}  # by slot
    waiting = iter(range(first, first + episodes))

    def begin(slot: int) -> None:
        number = next(waiting, None)
        running.pop(slot, None)
        if number is None:
            return
        batch.start(slot, seed=seed, number=number, options=options)
        running[slot] = _Run(number=number)

    for slot in range(width):
        begin(slot)
    while running:
        slots = sorted(running)
        runs = [running[s] for s in slots]
        observations = np.stack([batch.observe(s) for s in slots])
        starts = np.array([not run.begun for run in runs])
        states = None if starts.all() else [run.state for run in runs]
        actions, after = agent.predict(observations, states, starts, deterministic=True)
        for k, run in enumerate(runs):
            run.state, run.begun = (None if after is None else after[k]), True
            _note(batch, slots[k], run)
        found = batch.step(slots, list(actions))
        for k, run in enumerate(runs):
            run.actions.append(code_of(batch.actions, actions[k]))
            reward, terminated, truncated = (each[k].item() for each in found.arrays)
            if terminated:
                run.verdict_reward = reward
            else:  # a record was taken
                run.price -= reward
                run.excited += int(np.count_nonzero(batch.actions.decode(actions[k]).levels))
            if terminated or truncated:
                rows[run.number] = _row(batch, slots[k], run, found.info(k), name, seed)
                if progress is not None:
                    progress(len(rows))
                begin(slots[k])
    return [rows[number] for number in range(first, first + episodes)]


def _note(batch: EnvBatch, slot: int, run: _Run) -> None:
    """Log the agent's posterior after the latest record, and the cost of the record."""
    episode = batch.episode(slot)
    found = getattr(run.state, "probabilities", None)
    run.probabilities = None if found is None else np.array(found, dtype=float)
    if episode.records == 0:
        return
    told: dict[str, Any] = {"price": run.price, "seconds": episode.seconds}
    p = run.probabilities
    if p is not None:
        best = int(np.argmax(p))
        truth = _at(p, batch.hypotheses, episode.fault.hypothesis)
        unsure = batch.actions.allows_unsure(episode.records, episode.measured)
        named = best_verdict(batch, p, unsure=unsure)
        told |= {"best": batch.hypotheses[best], "confidence": float(p[best])}
        told |= {"truth": truth or 0.0, "verdict": named}
    for name, value in told.items():
        run.trails[name].append(value)


def _row(
    batch: EnvBatch, slot: int, run: _Run, info: Mapping[str, Any], name: str, seed: int
) -> EpisodeRow:
    """Summarise an episode as a row."""
    names = batch.hypotheses
    episode = batch.episode(slot)
    trails = {f"trail_{name}": tuple(values) for name, values in run.trails.items()}
    found: dict[str, Any] = {**vars(fault_parameters(batch.sampler, episode.fault)), **trails}
    truth, verdict, p = info["fault"], info["verdict"], run.probabilities
    level = batch.settings.difficulty
    return EpisodeRow(
        agent=name,
        seed=seed,
        episode=run.number,
        difficulty=level if isinstance(level, str) else "own",
        truth=truth,
        verdict=verdict,
        success=bool(info["is_success"]),
        link_success=bool(info["link_success"]),
        poses=info["poses"],
        records=info["records"],
        seconds=info["seconds"],
        excited=run.excited,
        price=run.price,
        reward=run.verdict_reward - run.price,
        truncated="failure" in info,
        confidence=_at(p, names, verdict),
        truth_probability=_at(p, names, truth),
        actions=" ".join(run.actions),
        **found,
    )


def _at(p: NDArray[np.float64] | None, names: Sequence[str], name: str | None) -> float | None:
    """Probability of a hypothesis, if it exists."""
    return float(p[names.index(name)]) if p is not None and name in names else None
