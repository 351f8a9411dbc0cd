"""Registry of estimators, and the tuned settings and weights that ship by arm and difficulty."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from loose_agents.core.base import Problem
from loose_agents.core.belief_agent import Estimator, Situation, Sure, records_taken
from loose_env.diagnosis import Belief, LinkReadings, link_axes
from loose_env.envs import DiagnosisSettings, ObservationLayout, difficulty_named
from loose_env.errors import InvalidSetting, UnknownName
from loose_env.wrappers import Posterior, analytic_posterior, record_from

__all__ = [
    "ESTIMATORS",
    "WEIGHTS",
    "Tracker",
    "belief_of",
    "feature_size",
    "further_features",
    "links_from",
    "make_estimator",
    "setting_name",
    "tuned",
    "tuning_name",
    "usual_estimator",
    "weights_digest",
    "weights_path",
]


WEIGHTS = Path(__file__).parents[1] / "weights"
"""Folder of tuned settings and trained weights."""


OWN_WEIGHTS = "LOOSE_ENV_WEIGHTS"
"""Environment variable: folder of weights of one's own, which go before the shipped ones."""


def weights_path(name: str) -> Path:
    """Path of weights or tuned settings by name, such as "ppo-vera-default".

    Those in the folder that the environment variable ``LOOSE_ENV_WEIGHTS`` names come first.
    """
    own = os.environ.get(OWN_WEIGHTS)
    if own and (Path(own) / name).exists():
        return Path(own) / name
    return WEIGHTS / name


def weights_digest() -> str:
    """SHA-256 of all tuned settings and trained weights, one's own included.

    What is resumed may only go on with the weights that it began with.
    """
    found = hashlib.sha256()
    folders = [WEIGHTS, *([Path(os.environ[OWN_WEIGHTS])] if os.environ.get(OWN_WEIGHTS) else [])]
    for folder in folders:
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                found.update(path.relative_to(folder).as_posix().encode("utf-8"))
                found.update(path.read_bytes())
    return found.hexdigest()


def tuned(problem: Problem) -> dict[str, Any]:
    """Settings tuned on training episodes of an arm, difficulty and rules; may be empty.

    ``stop`` maps agents to the probability at which they stop, ``constant`` holds the best
    levels of one joint, ``fixed`` the best sequences of records, ``information`` the factors on
    expected information. What was not tuned under other rules (`tuning_name`) is that of the
    usual ones. Written by scripts/agents/tune_agents.py and scripts/agents/fit_information.py.
    """
    usual, own = (
        json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
        for path in (weights_path(f"{f(problem)}.json") for f in (setting_name, tuning_name))
    )
    if setting_name(problem) != tuning_name(problem):
        usual.pop("fixed", None)  # actions of other rules
    return {**usual, **own, "stop": {**usual.get("stop", {}), **own.get("stop", {})}}


def tuned_stopping(problem: Problem, agent: str) -> Sure:
    """Stopping rule tuned for an agent; that of `Sure` by default where it was not tuned."""
    return Sure(probability=tuned(problem).get("stop", {}).get(agent, Sure.probability))


def usual_estimator(problem: Problem) -> str:
    """Name of the learned posterior where one is trained for a problem, else the analytic one."""
    trained = weights_path(f"posterior-{setting_name(problem)}").is_dir()
    return "amortised" if trained else "posterior"


def setting_name(problem: Problem) -> str:
    """Name of the tuned or trained item for an arm at a difficulty."""
    difficulty = problem.settings.difficulty
    name = difficulty if isinstance(difficulty, str) else "own"
    return f"{problem.arm.name}-{name}"


def links_from(
    layout: ObservationLayout, observation: NDArray[np.float32], slot: int
) -> LinkReadings:
    """Decode what the accelerometers on links show in one record of an observation.

    Raises
    ------
    InvalidSetting
        If the settings have no accelerometers on links.
    """
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


def tuning_name(problem: Problem) -> str:
    """Name of the settings tuned for an arm, a difficulty and rules other than the usual ones.

    What was trained is known by `setting_name`: a posterior holds for any rules of its arm.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> from loose_env.envs import DiagnosisSettings, Prices
    >>> tuning_name(Problem.of(planar(4), DiagnosisSettings(max_excited=1, durations=(0.2,))))
    'planar4-default-excited1-0.2s'
    >>> tuning_name(Problem.of(planar(4), DiagnosisSettings(prices=Prices(miss=-2.0))))
    'planar4-default-miss-2'
    """
    settings, arm, usual = problem.settings, problem.arm, DiagnosisSettings()
    parts = [setting_name(problem)]
    if settings.max_excited is not None:
        parts.append(f"excited{settings.max_excited}")
    if settings.max_moved is not None:
        parts.append(f"moved{settings.max_moved}")
    if settings.durations != usual.durations:
        parts += [f"{seconds:g}s" for seconds in settings.durations]
    if arm.rated_level is not None:
        parts.append("level" + "_".join(f"{level:g}" for level in arm.levels))
    gravity = arm.model.opt.gravity
    if not np.allclose(gravity, (0.0, 0.0, -9.81), atol=0.1):
        parts.append("gravity" + "_".join(f"{g:g}" for g in gravity))
    for name, price in vars(settings.prices).items():
        if price != getattr(usual.prices, name):
            parts.append(f"{name}{price:g}")
    if settings.moves != usual.moves:
        parts.append("moves" + "_".join(f"{degrees:g}" for degrees in settings.moves))
    for name in ("max_records", "unsure_after"):
        if getattr(settings, name) != getattr(usual, name):
            parts.append(f"{name}{getattr(settings, name)}")
    if settings.kinds != usual.kinds:
        parts.append("kinds_" + "_".join(settings.kinds))
    if settings.sensors != usual.sensors:
        parts.append("sensors" + hashlib.sha256(repr(settings.sensors).encode()).hexdigest()[:8])
    return "-".join(parts)


@dataclass
class _Memory:
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
        known = self.posterior.hypotheses
        unknown = [name for name in problem.hypotheses if name not in known]
        if unknown:
            raise InvalidSetting(
                f"the posterior knows nothing of {unknown}; it knows {list(known)}"
            )
        self._order = [known.index(name) for name in problem.hypotheses]

    def begin(self) -> _Memory:
        """Return the initial state of an episode."""
        return _Memory(belief=self.posterior.start())

    def follow(self, observation: NDArray[np.float32], memory: _Memory) -> NDArray[np.float64]:
        """Update with the new records; return the hypotheses' probabilities."""
        layout = self.problem.layout
        taken = records_taken(self.problem, observation)
        for slot in range(memory.records, taken):
            record = record_from(layout, observation, slot)
            if record is not None:
                memory.belief = self.posterior.update(memory.belief, record)
        memory.records = taken
        return np.asarray(memory.belief.probabilities[self._order])

    @property
    def feature_size(self) -> int:
        """Number of elements that `features` returns."""
        n, d = self.problem.arm.n, len(self.problem.arm.axes)
        return n * (d * (d + 1) // 2) + 2 * n

    def features(self, observation: NDArray[np.float32], memory: _Memory) -> NDArray[np.float32]:
        """Policy features in addition to the probabilities.

        For every link the mean of its sliding direction's products of components, in the link's
        frame, times the probability that it is loose; then for every fault the mean place of its
        friction among the nodes, from -1 for the lowest to 1 for the highest.
        """
        belief = getattr(memory.belief, "belief", memory.belief)
        log = logsumexp(belief.loose, axis=0)
        top = log.max()
        weight = np.exp(log - top)
        n, u = belief.links, belief.directions
        total = weight.sum() + np.exp(belief.healthy - top).sum()
        by_direction = weight[: n * len(u)].sum(1).reshape(n, len(u)) / total
        upper = np.triu_indices(u.shape[1])
        products = (u[:, upper[0]] * u[:, upper[1]])[None]
        directions = (by_direction[..., None] * products).sum(1)
        slides = weight[: n * len(u)].reshape(n, len(u), -1).sum(1)
        by_node = np.concatenate([slides, weight[n * len(u) :]]) + 1e-12
        nodes = np.linspace(-1.0, 1.0, by_node.shape[1])
        friction = by_node @ nodes / by_node.sum(1)
        return np.concatenate([directions.ravel(), friction]).astype(np.float32)


def belief_of(situation: Situation) -> Belief:
    """Log-weights of locations and frictions behind a situation's probabilities.

    Raises
    ------
    InvalidSetting
        If its estimator keeps none: the policy needs one of the posteriors.
    """
    belief = getattr(situation.memory, "belief", None)
    belief = getattr(belief, "belief", belief)
    if not isinstance(belief, Belief):
        raise InvalidSetting(
            "this policy needs an estimator that keeps a posterior over places and frictions, "
            f"not one whose memory is {type(situation.memory).__name__}"
        )
    return belief


def _posterior(problem: Problem) -> Estimator:
    return Tracker(problem)


def _amortised(problem: Problem) -> Estimator:
    from loose_env.diagnosis import AmortisedPosterior

    difficulty = difficulty_named(problem.settings.difficulty)
    posterior = AmortisedPosterior.load(
        weights_path(f"posterior-{setting_name(problem)}"),
        problem.linear,
        problem.settings.sensors,
        difficulty.mismatch,
        kinds=difficulty.probabilities(problem.settings.kinds),
    )
    return Tracker(problem, posterior)


def _ratio(problem: Problem) -> Estimator:
    from loose_agents.core.ratio_posterior import RatioPosterior

    return RatioPosterior.load(weights_path(f"ratio-{tuning_name(problem)}"), problem)


ESTIMATORS: dict[str, tuple[Callable[[Problem], Estimator], str]] = {
    "posterior": (_posterior, "the analytic posterior over the faults"),
    "amortised": (_amortised, "the posterior with a learned likelihood"),
    "ratio": (_ratio, "neural ratio estimation with the library sbi, on the raw observation"),
}
"""Constructor and short description of each estimator."""


def make_estimator(name: str, problem: Problem) -> Estimator:
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


def feature_size(estimator: Estimator) -> int:
    """Number of an estimator's features beyond its probabilities; 0 by default.

    An estimator that has more to say, such as what the next record could show under each
    hypothesis, has an attribute ``feature_size`` and a method
    ``features(observation, memory)`` that returns so many numbers of the order of one.
    """
    return int(getattr(estimator, "feature_size", 0))


def further_features(
    estimator: Estimator, observation: NDArray[np.float32], memory: Any
) -> NDArray[np.float32]:
    """Features of an estimator beyond its probabilities (feature_size,)."""
    if not feature_size(estimator):
        return np.zeros(0, dtype=np.float32)
    return np.asarray(
        estimator.features(observation, memory),  # type: ignore[attr-defined]
        dtype=np.float32,
    )
