"""Agents that keep a posterior over the hypotheses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.base import Problem
from loose_env.diagnosis.posterior import Belief, FaultPosterior, PosteriorSettings
from loose_env.diagnosis.record import RecordStatistics
from loose_env.envs.difficulty import difficulty_named
from loose_env.envs.observation import ObservationLayout

__all__ = ["Tracker", "record_from", "tracker_features"]


def record_from(
    layout: ObservationLayout, observation: NDArray[np.float32], slot: int
) -> RecordStatistics | None:
    """Read the statistics of one record back from an observation; None for an empty slot."""

    def at(name: str) -> NDArray[np.float64]:
        return layout.physical(observation, name)[slot]

    if at("valid")[0] < 0.5:
        return None
    arm = layout.arm
    n, d = arm.n, len(arm.axes)
    rms = at("tool_rms")
    covariance = np.diag(rms**2)
    for value, (i, j) in zip(
        at("tool_correlation"), zip(*np.triu_indices(d, 1), strict=True), strict=True
    ):
        covariance[i, j] = covariance[j, i] = value * rms[i] * rms[j]
    products = np.zeros((d, d))
    products[np.triu_indices(d)] = at("lowest_direction")
    products = products + np.triu(products, 1).T
    direction = np.linalg.eigh(products)[1][:, -1]
    lowest, highest = float(at("coherence")[0]), float(at("correlation")[0])
    return RecordStatistics(
        pose=layout.record_poses_of(observation)[slot],
        torque=at("torque") * np.array(arm.torque_limits),
        duration=float(at("duration")[0]),
        transmission=at("transmission").reshape(n, d).T,
        transmission_by_instrument=at("transmission_by_instrument").reshape(n, d).T,
        joint_rms=at("joint_rms"),
        inertia=at("inertia"),
        tool_covariance=covariance,
        lowest_direction=direction,
        lowest_coherence=lowest,
        maximum_correlation=highest,
        skewness=at("skewness"),
        kurtosis=at("kurtosis"),
        lowest_skewness=float(at("lowest_skewness")[0]),
        lowest_kurtosis=float(at("lowest_kurtosis")[0]),
    )


@dataclass
class _Memory:
    """Belief of one episode and how many records went into it."""

    belief: Belief
    records: int = 0
    rng: np.random.Generator | None = None


class Tracker:
    """Turns observations into beliefs, one new record at a time.

    Parameters
    ----------
    problem : Problem
        The nominal arm and the rules.

    Raises
    ------
    InvalidSetting
        If a kind of fault that may come up has no model in the posterior.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        difficulty = difficulty_named(problem.settings.difficulty)
        self.posterior = FaultPosterior(
            problem.linear,
            problem.settings.sensors,
            PosteriorSettings(
                friction=difficulty.friction,
                mismatch=difficulty.mismatch,
                kinds=difficulty.probabilities(problem.settings.kinds),
            ),
        )
        known = self.posterior.hypotheses
        self._order = [known.index(name) for name in problem.hypotheses]

    def begin(self, rng: np.random.Generator | None = None) -> _Memory:
        """Return the memory of a new episode."""
        return _Memory(belief=self.posterior.start(), rng=rng)

    def follow(self, observation: NDArray[np.float32], memory: _Memory) -> NDArray[np.float64]:
        """Take in the records that are new; return the probabilities of the hypotheses."""
        layout = self.problem.layout
        share = float(layout.physical(observation, "spent")[0])
        taken = round(share * self.problem.settings.max_records)
        for slot in range(memory.records, taken):
            record = record_from(layout, observation, slot)
            if record is not None:
                memory.belief = self.posterior.update(memory.belief, record)
        memory.records = taken
        return np.asarray(memory.belief.probabilities[self._order])


def tracker_features(problem: Problem, observation: Any, probabilities: Any) -> NDArray[np.float32]:
    """Lay out what a learned policy sees: probabilities, their logs, pose and spending."""
    p = np.asarray(probabilities, dtype=float)
    start = observation[: len(problem.layout.global_elements)]
    entropy = -np.sum(p * np.log(np.maximum(p, 1e-12)))
    logs = np.clip(np.log(np.maximum(p, 1e-6)), -14.0, 0.0) / 7.0
    return np.concatenate([p, logs, [p.max(), entropy], start]).astype(np.float32)
