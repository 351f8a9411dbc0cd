"""Agent of estimator, policy and stopping rule; estimators made by name, shipped weights."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from loose_agents.base import Agent, EpisodeAgent, Problem
from loose_agents.stored import setting_name, tuned, tuning_name, weights_path
from loose_env.diagnosis import Belief, LinkReadings, link_axes, misfit, read_network
from loose_env.envs import EnvBatch, ObservationLayout, difficulty_named
from loose_env.errors import InvalidSetting, UnknownName
from loose_env.faults import UNSURE
from loose_env.typing import Array
from loose_env.wrappers import Posterior, analytic_posterior, checked_order, taken_in

SURPRISING = 0.003
"""p-value of an episode among those of the trained kind, below which nothing is named."""
DECISIVE = 0.3
"""Share of that p-value below which further records are not waited for."""


class Estimator(Protocol):
    """Maps the records of episodes to probabilities of the hypotheses."""

    problem: Problem
    """The nominal arm and the rules."""

    def begin(self) -> Any:
        """Return the initial state of an episode."""
        ...

    def follow(
        self, observations: NDArray[np.float32], memories: Sequence[Any]
    ) -> NDArray[np.float64]:
        """Update with the new records of A episodes; return the probabilities (A, hypotheses).

        May change the memories. They stand in the order of ``problem.hypotheses``.
        """
        ...


@dataclass(frozen=True, kw_only=True, eq=False)
class Situation:
    """Information available when the next record is chosen."""

    observation: NDArray[np.float32]
    """The environment's flat observation."""
    pose: NDArray[np.float64]
    """Joint positions [rad, m where one slides] (n,)."""
    records: int
    """Records taken so far."""
    probabilities: NDArray[np.float64]
    """Of the hypotheses, by the estimator (hypotheses,)."""
    memory: Any
    """The estimator's memory, for policies that know what is in it."""
    rng: np.random.Generator
    """The episode's own generator."""


class Policy(Protocol):
    """Chooses the next record."""

    def choose(self, situation: Situation) -> NDArray[np.int64]:
        """Return a measurement action, never a verdict.

        Where there is a method ``choose_all``, it is asked for those of several situations.
        """
        ...


class StoppingRule(Protocol):
    """Decides when to stop measuring."""

    def stop(self, situation: Situation) -> bool:
        """Return True to stop and give a verdict; called after at least one record."""
        ...


@dataclass(frozen=True, kw_only=True)
class Sure:
    """Stops once the maximum posterior probability reaches a threshold."""

    probability: float = 0.9
    """From which probability on."""

    def stop(self, situation: Situation) -> bool:
        """Return True once the maximum probability reaches the threshold."""
        return bool(situation.probabilities.max() >= self.probability)


@dataclass(frozen=True, kw_only=True)
class AfterRecords:
    """Stopping rule that fires after a fixed number of records."""

    records: int
    """Records before the verdict."""

    def stop(self, situation: Situation) -> bool:
        """Return True once the fixed number of records is reached."""
        return situation.records >= self.records


def goes_on(agent: Agent, records: int) -> Agent:
    """Return a copy of an agent that always takes a given number of records."""
    if not hasattr(agent, "stopping"):
        raise InvalidSetting(
            f"{type(agent).__name__} has no stopping rule to replace: only agents made of an "
            "estimator, a policy and a stopping rule can be made to go on"
        )
    changed = copy.copy(agent)
    changed.stopping = AfterRecords(records=records)
    return changed


@dataclass
class _Memory:
    """State of one episode: its generator and the estimator's state."""

    rng: np.random.Generator
    estimate: Any
    probabilities: NDArray[np.float64] | None = None
    """Of the hypotheses, after the latest record (hypotheses,); read by the evaluator."""


class BeliefAgent(EpisodeAgent):
    """Measures by its policy until the stopping rule fires, then gives a verdict.

    Parameters
    ----------
    problem : Problem
        The nominal arm and the rules.
    estimator : Estimator
        What the records say.
    policy : Policy
        What to measure next.
    stopping : StoppingRule
        When to stop. When the records have run out it is not asked.
    surprising : float
        Below which p-value an episode is so unlike all that the estimator knows that the verdict
        is "unsure"; 0: never. See `surprise_of`.
    """

    def __init__(
        self,
        problem: Problem,
        estimator: Estimator,
        policy: Policy | None,
        stopping: StoppingRule | None,
        *,
        seed: int = 0,
        surprising: float = SURPRISING,
    ) -> None:
        super().__init__(problem, seed=seed)
        self.estimator = estimator
        self.policy: Any = policy
        self.stopping: Any = stopping
        self.surprising = surprising

    def begin(self, rng: np.random.Generator) -> Any:
        """Start from the prior."""
        return _Memory(rng=rng, estimate=self.estimator.begin())

    def act(self, observation: NDArray[np.float32], memory: _Memory) -> NDArray[np.int64]:
        """Take a measurement, or give the verdict of highest expected reward."""
        return self.act_all(observation[None], [memory])[0]

    def act_all(
        self, observations: NDArray[np.float32], memories: Sequence[_Memory]
    ) -> list[NDArray[np.int64]]:
        """Choose an action for each episode; their new records are taken in together."""
        return self.decide_all(self.situations(observations, memories))

    def decide_all(self, situations: Sequence[Situation]) -> list[NDArray[np.int64]]:
        """Take a measurement in each episode, or give the verdict of highest expected reward."""
        decided = [self.decide(now) for now in situations]
        going = [now for now, own in zip(situations, decided, strict=True) if own is None]
        if not going:
            return [own for own in decided if own is not None]
        together = getattr(self.policy, "choose_all", None)
        chosen = iter(together(going) if together else map(self.policy.choose, going))
        return [next(chosen) if own is None else own for own in decided]

    def decide(self, situation: Situation) -> NDArray[np.int64] | None:
        """Give the verdict of highest expected reward, or None to take the policy's record."""
        if situation.records > 0 and (
            situation.records >= self.problem.settings.max_records
            or self.stopping.stop(situation)
            or surprise_of(situation.memory) < DECISIVE * self.surprising
        ):
            named = verdict_of(self.problem, situation, self.surprising)
            return None if named is None else self.problem.verdict(named)
        return None

    def situations(
        self, observations: NDArray[np.float32], memories: Sequence[_Memory]
    ) -> list[Situation]:
        """Take the new records in; return what is known now of each episode."""
        probabilities = self.estimator.follow(observations, [m.estimate for m in memories])
        poses = self.problem.layout.pose_of(observations)
        taken = self.problem.layout.records_of(observations)
        for memory, own in zip(memories, probabilities, strict=True):
            memory.probabilities = own
        return [
            Situation(
                observation=observations[k],
                pose=poses[k],
                records=int(taken[k]),
                probabilities=probabilities[k],
                memory=memory.estimate,
                rng=memory.rng,
            )
            for k, memory in enumerate(memories)
        ]


def records_measured(problem: Problem, observations: NDArray[np.float32]) -> Any:
    """Number of records in observations (..., size) that are not empty."""
    return np.count_nonzero(problem.layout.slots_of(observations)[..., 0], axis=-1)


def surprise_of(memory: Any) -> float:
    """p-value of an episode under the estimator's training distribution.

    Estimators say it in ``surprise`` of the belief that their memory holds; one for those that
    say nothing.
    """
    return float(getattr(getattr(memory, "belief", None), "surprise", 1.0))


def verdict_of(
    problem: Problem, situation: Situation, surprising: float = SURPRISING
) -> str | None:
    """Verdict of highest expected reward; "unsure" for out-of-distribution episodes.

    None where it would be "unsure" and may not be yet: then more is to be measured.
    """
    measured = records_measured(problem, situation.observation)
    unsure = problem.actions.allows_unsure(situation.records, measured)
    if surprise_of(situation.memory) < surprising:
        if unsure:
            return UNSURE
        if situation.records < problem.settings.max_records:
            return None
    return best_verdict(problem, situation.probabilities, unsure=unsure)


def best_verdict(
    problem: Problem | EnvBatch, probabilities: NDArray[np.float64], *, unsure: bool = True
) -> str:
    """Verdict of the highest expected reward under the environment's rewards.

    "unsure" only where it may be said and is worth more than every name.
    """
    prices, names = problem.settings.prices, problem.hypotheses
    worth = {
        named: sum(
            p * prices.verdict(named, truth) for p, truth in zip(probabilities, names, strict=True)
        )
        for named in (*names, *([UNSURE] if unsure else []))
    }
    return max(worth, key=lambda named: worth[named])


def tuned_stopping(problem: Problem, agent: str) -> Sure:
    """Stopping rule tuned for an agent; that of `Sure` by default where it was not tuned."""
    return Sure(probability=tuned(problem).get("stop", {}).get(agent, Sure.probability))


def usual_estimator(problem: Problem) -> str:
    """Name of the best posterior of a task: one trained for it, else the analytic one."""
    if weights_path(f"foresight-{tuning_name(problem)}").is_dir():
        return "calibrated"
    folder = weights_path(f"posterior-{setting_name(problem)}")
    rules = (problem.arm, problem.settings.durations)
    trained = folder.is_dir() and not misfit(read_network(folder)[0], *rules)
    return "amortised" if trained else "posterior"


def links_from(
    layout: ObservationLayout, observation: NDArray[np.float32], slot: int
) -> LinkReadings:
    """Decode what the accelerometers on links show in one record of an observation."""
    choice = layout.settings.sensors.on_links
    if choice is None:
        raise InvalidSetting("the observation holds no accelerometers on links")
    at = layout.groups_of(layout.slots_of(observation)[slot])
    count, axes = len(choice.on(layout.arm)), len(link_axes(layout.arm, choice))
    return LinkReadings(
        transmission_by_instrument=at["link_transmission_by_instrument"].reshape(
            count, axes, layout.arm.n
        ),
        rms=at["link_rms"].reshape(count, axes),
    )


@dataclass
class _Tracked:
    """Belief of one episode and the number of records in it."""

    belief: Any
    records: int = 0


class Tracker:
    """Updates beliefs from observations, one new record at a time.

    Parameters
    ----------
    problem : Problem
        The nominal arm and the rules.
    posterior : Posterior, optional
        What weighs the records; the analytic posterior by default.

    Raises
    ------
    InvalidSetting
        If a kind of fault that may come up has no model in the posterior.
    """

    def __init__(self, problem: Problem, posterior: Posterior | None = None) -> None:
        self.problem = problem
        self.posterior = (
            analytic_posterior(problem.linear, problem.settings) if posterior is None else posterior
        )
        self._order = checked_order(self.posterior, problem.hypotheses)

    def begin(self) -> _Tracked:
        """Return the initial state of an episode."""
        return _Tracked(belief=self.posterior.start())

    def follow(
        self, observations: NDArray[np.float32], memories: Sequence[_Tracked]
    ) -> NDArray[np.float64]:
        """Update with the new records of A episodes; return the probabilities (A, hypotheses)."""
        before, known = [m.belief for m in memories], np.array([m.records for m in memories])
        after, taken = taken_in(self.posterior, self.problem.layout, observations, before, known)
        for memory, belief, count in zip(memories, after, taken, strict=True):
            memory.belief, memory.records = belief, int(count)
        return np.array([belief.probabilities[self._order] for belief in after])

    @property
    def feature_size(self) -> int:
        """Number of elements that `features` returns."""
        n, d = self.problem.arm.n, len(self.problem.arm.axes)
        return n * (d * (d + 1) // 2) + 2 * n

    def features(self, observation: NDArray[np.float32], memory: _Tracked) -> NDArray[np.float32]:
        """Policy features in addition to the probabilities, as `seen` tells them."""
        _, shown = self.seen([memory])
        return np.asarray(shown[0])

    def seen(self, memories: Sequence[_Tracked]) -> tuple[Array, NDArray[np.float32]]:
        """Probabilities by the posterior (A, hypotheses) and further features (A, features).

        For every link the mean of its sliding direction's products of components, in the link's
        frame, times the probability that it is loose; then for every fault the mean place of its
        friction among the nodes, from -1 for the lowest to 1 for the highest.
        """
        beliefs = [getattr(memory.belief, "belief", memory.belief) for memory in memories]
        n, u = beliefs[0].links, beliefs[0].directions
        loose, healthy = (
            np.stack([getattr(b, name) for b in beliefs]) for name in ("loose", "healthy")
        )
        top = np.maximum(loose.max(axis=(1, 2, 3)), healthy.max(axis=1))[:, None]
        weight = np.exp(loose - top[..., None, None]).sum(1)  # (A, places, frictions)
        total = weight.sum((1, 2)) + np.exp(healthy - top).sum(1)
        slides = weight[:, : n * len(u)].reshape(len(beliefs), n, len(u), -1)
        upper = np.triu_indices(u.shape[1])
        products = slides.sum(3) @ (u[:, upper[0]] * u[:, upper[1]]) / total[:, None, None]
        by_node = np.concatenate([slides.sum(2), weight[:, n * len(u) :]], axis=1)
        by_node += 1e-12 * total[:, None, None]
        nodes = np.linspace(-1.0, 1.0, by_node.shape[2])
        friction = by_node @ nodes / by_node.sum(2)
        shown = np.concatenate([products.reshape(len(beliefs), -1), friction], axis=1)
        told = np.array([memory.belief.probabilities[self._order] for memory in memories])
        return told, shown.astype(np.float32)


class Calibrated(Tracker):
    """The analytic posterior with its probabilities corrected by a network."""

    def __init__(self, problem: Problem, foresight: Any = None) -> None:
        from loose_agents.rl.foresight import Foresight

        super().__init__(problem)
        self.foresight = Foresight.load(problem) if foresight is None else foresight

    def follow(
        self, observations: NDArray[np.float32], memories: Sequence[Any]
    ) -> NDArray[np.float64]:
        """Update with the new records of A episodes; return the probabilities (A, hypotheses)."""
        found = np.array(super().follow(observations, memories))
        rows = [k for k, memory in enumerate(memories) if memory.records > 0]
        if rows:
            at = self.problem.linear.geometry(self.problem.layout.pose_of(observations[rows]))
            found[rows] = self.foresight.corrected(*self.seen([memories[k] for k in rows]), at)
        return found


def belief_of(situation: Situation) -> Belief:
    """Log-weights of locations and frictions behind a situation's probabilities."""
    belief = getattr(situation.memory, "belief", None)
    belief = getattr(belief, "belief", belief)
    if not isinstance(belief, Belief):
        raise InvalidSetting(
            "this policy needs an estimator that keeps a posterior over places and frictions, "
            f"not one whose memory is {type(situation.memory).__name__}"
        )
    return belief


def _amortised(problem: Problem) -> Tracker:
    from loose_env.diagnosis import AmortisedPosterior

    difficulty = difficulty_named(problem.settings.difficulty)
    posterior = AmortisedPosterior.load(
        weights_path(f"posterior-{setting_name(problem)}"),
        problem.linear,
        problem.settings.sensors,
        difficulty.mismatch,
        kinds=difficulty.probabilities(problem.settings.kinds),
        durations=problem.settings.durations,
    )
    return Tracker(problem, posterior)


ESTIMATORS: dict[str, tuple[Callable[[Problem], Tracker], str]] = {
    "posterior": (Tracker, "the analytic posterior over the faults"),
    "amortised": (_amortised, "the posterior with a learned likelihood"),
    "calibrated": (Calibrated, "the analytic posterior, its probabilities corrected by a network"),
}
"""Constructor and short description of each estimator."""


def make_estimator(name: str, problem: Problem) -> Tracker:
    """Make an estimator for a problem.

    Raises
    ------
    UnknownName
        If there is no estimator of that name.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> from loose_env.envs import DiagnosisSettings
    >>> make_estimator("posterior", Problem.of(planar(2), DiagnosisSettings())).problem.arm.name
    'planar2'
    """
    if name not in ESTIMATORS:
        raise UnknownName(f"unknown estimator {name!r}; estimators are {list(ESTIMATORS)}")
    return ESTIMATORS[name][0](problem)
