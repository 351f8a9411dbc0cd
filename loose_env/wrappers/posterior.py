"""The posterior over the hypotheses as observation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from loose_env.arms import LinearArm
from loose_env.diagnosis import FaultPosterior, PosteriorSettings, RecordStatistics
from loose_env.envs import DiagnosisSettings, Element, ObservationLayout, difficulty_named
from loose_env.errors import InvalidSetting
from loose_env.wrappers.base import DiagnosisWrapper

__all__ = [
    "PROBABILITY_FLOOR",
    "Posterior",
    "PosteriorObservation",
    "analytic_posterior",
    "posterior_bounds",
    "posterior_features",
    "record_from",
]

PROBABILITY_FLOOR = 1e-6
"""Probabilities below count as this in logarithms: one arm does not decide a mean [1]."""


class Posterior(Protocol):
    """Protocol of a posterior, analytic or learned, updated record by record."""

    hypotheses: tuple[str, ...]
    """Hypotheses in the order of its probabilities."""

    def start(self) -> Any:
        """Return the prior, an object with ``probabilities``."""
        ...

    def update(self, belief: Any, record: RecordStatistics) -> Any:
        """Update with one record."""
        ...


def analytic_posterior(linear: LinearArm, settings: DiagnosisSettings) -> FaultPosterior:
    """Build the posterior whose likelihood is derived from the nominal arm alone.

    Raises
    ------
    InvalidSetting
        If a kind of fault that may come up has no model in it.
    """
    difficulty = difficulty_named(settings.difficulty)
    return FaultPosterior(
        linear,
        settings.sensors,
        PosteriorSettings(
            friction=difficulty.friction,
            friction_over=difficulty.friction_over,
            mismatch=difficulty.mismatch,
            kinds=difficulty.probabilities(settings.kinds),
        ),
    )


def record_from(
    layout: ObservationLayout, observation: NDArray[np.float32], slot: int
) -> RecordStatistics | None:
    """Decode one record's statistics from an observation; None for an empty slot."""
    row = layout.slots_of(observation)[slot]
    if row[0] < 0.5:
        return None
    at = layout.groups_of(row)
    arm = layout.arm
    n, d = arm.n, len(arm.axes)
    rms = at["tool_rms"]
    covariance = np.diag(rms**2)
    upper = np.triu_indices(d, 1)
    covariance[upper] = at["tool_correlation"] * rms[upper[0]] * rms[upper[1]]
    covariance.T[upper] = covariance[upper]
    products = np.zeros((d, d))
    products[np.triu_indices(d)] = at["lowest_direction"]
    products = products + np.triu(products, 1).T
    return RecordStatistics(
        pose=at["pose"],
        torque=at["torque"] * np.array(arm.torque_limits),
        duration=float(at["duration"][0]),
        transmission=at["transmission"].reshape(n, d).T,
        transmission_by_instrument=at["transmission_by_instrument"].reshape(n, d).T,
        joint_rms=at["joint_rms"],
        inertia=at["inertia"],
        tool_covariance=covariance,
        lowest_direction=np.linalg.eigh(products)[1][:, -1],
        lowest_coherence=float(at["coherence"][0]),
        maximum_correlation=float(at["correlation"][0]),
        skewness=at["skewness"],
        kurtosis=at["kurtosis"],
        lowest_skewness=float(at["lowest_skewness"][0]),
        lowest_kurtosis=float(at["lowest_kurtosis"][0]),
    )


def posterior_bounds(hypotheses: int, start: Sequence[Element]) -> list[tuple[float, float]]:
    """Bounds of `posterior_features`, one pair for each number."""
    return [
        *[(0.0, 1.0)] * hypotheses,
        *[(-2.0, 0.0)] * hypotheses,
        *[(0.0, 1.0)] * 3,
        *((e.low, e.high) for e in start),
    ]


def posterior_features(
    probabilities: NDArray[np.float64], start: NDArray[np.float32]
) -> NDArray[np.float64]:
    """Numbers that a policy sees of a posterior.

    One after the other: the probabilities of the hypotheses; their logarithms (the natural ones,
    those below 1e-6 cut off, divided by 7); the largest probability; the logarithm of what is
    left beside it, from 0 to 1 at 0.1 %; the entropy as a share of the largest possible; the
    observation's global elements ``start``.
    """
    p = np.asarray(probabilities, dtype=float)
    logs = np.log(np.maximum(p, PROBABILITY_FLOOR)) / 7.0
    entropy = -np.sum(p * np.log(np.maximum(p, 1e-12))) / np.log(max(len(p), 2))
    doubt = np.log(np.maximum(1 - p.max(), 1e-3)) / np.log(1e-3)
    return np.concatenate([p, logs, [p.max(), doubt, entropy], start])


class PosteriorObservation(DiagnosisWrapper):
    """Shows the posterior over the hypotheses in place of the records.

    A plain Gymnasium wrapper: any library can train on it, alone or in
    ``gymnasium.make_vec(id, vectorization_mode="sync", wrappers=[PosteriorObservation])``. The
    observation is that of `posterior_features`; `info["probabilities"]` has the posterior itself,
    in the order of the environment's `hypotheses`.

    Parameters
    ----------
    env : gymnasium.Env
        The environment; records are read from its full observation, so put this wrapper first.
    posterior : Posterior, optional
        What weighs the records: by default the analytic posterior, from the nominal arm alone.

    Raises
    ------
    InvalidSetting
        If the observation is another one already, or the posterior lacks a hypothesis.

    Examples
    --------
    >>> import gymnasium, loose_env
    >>> env = PosteriorObservation(gymnasium.make("loose_env/Vera-v0"))
    >>> observation, info = env.reset(seed=0)
    >>> observation.shape, info["probabilities"].round(2).tolist()
    ((21,), [0.33, 0.17, 0.17, 0.17, 0.17])
    """

    def __init__(self, env: gymnasium.Env[Any, Any], posterior: Posterior | None = None) -> None:
        super().__init__(env, posterior=posterior)
        inner = self.diagnosis
        if env.get_wrapper_attr("layout") is not inner.layout:
            raise InvalidSetting(
                "PosteriorObservation reads the full observation: put it inside the wrappers that "
                "change the records"
            )
        self._given = posterior
        if posterior is None:
            posterior = analytic_posterior(inner.batch.nominal, inner.settings)
        known = posterior.hypotheses
        unknown = [name for name in inner.hypotheses if name not in known]
        if unknown:
            raise InvalidSetting(
                f"the posterior knows nothing of {unknown}; it knows {list(known)}"
            )
        self.posterior = posterior
        self._order = [known.index(name) for name in inner.hypotheses]
        start = inner.layout.global_elements
        bounds = np.array(posterior_bounds(len(self._order), start), dtype=np.float32).T
        self.observation_space = spaces.Box(bounds[0], bounds[1], dtype=np.float32)
        self._belief: Any = None
        self._records = 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin an episode, from the prior."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._belief, self._records = self.posterior.start(), 0
        return self._observation(observation), {**info, "probabilities": self.probabilities}

    def step(self, action: Any) -> tuple[NDArray[np.float32], Any, bool, bool, dict[str, Any]]:
        """Take a step and update the posterior."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        taken = self.diagnosis.batch.episode(0).records
        for slot in range(self._records, taken):
            record = record_from(self.diagnosis.layout, observation, slot)
            if record is not None:
                self._belief = self.posterior.update(self._belief, record)
        self._records = taken
        info = {**info, "probabilities": self.probabilities}
        return self._observation(observation), reward, terminated, truncated, info

    def __getstate__(self) -> dict[str, Any]:
        """Attributes; the analytic posterior is built anew in a copy."""
        return {**self.__dict__, "posterior": self._given}

    def __setstate__(self, stored: dict[str, Any]) -> None:
        """Take up the attributes."""
        self.__dict__.update(stored)
        if self._given is None:
            inner = self.diagnosis
            self.posterior = analytic_posterior(inner.batch.nominal, inner.settings)

    @property
    def probabilities(self) -> NDArray[np.float64]:
        """Posterior of the environment's hypotheses (hypotheses,)."""
        return np.asarray(self._belief.probabilities[self._order])

    def _observation(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        start = observation[: len(self.diagnosis.layout.global_elements)]
        shown = posterior_features(self.probabilities, start).astype(np.float32)
        space = self.observation_space
        return np.clip(shown, space.low, space.high)  # type: ignore[attr-defined]
