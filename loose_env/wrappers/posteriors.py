"""Posteriors as wrappers and agents use them: the analytic one, decoded records, features."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from loose_env.arms import LinearArm
from loose_env.diagnosis import FaultPosterior, PosteriorSettings, RecordStatistics
from loose_env.envs import DiagnosisSettings, Element, ObservationLayout, difficulty_named
from loose_env.errors import InvalidSetting
from loose_env.typing import IndexArray

PROBABILITY_FLOOR = 1e-6
"""Probabilities below count as this in logarithms: one arm does not decide a mean [1]."""


class Posterior(Protocol):
    """Protocol of a posterior, analytic or learned, updated record by record."""

    hypotheses: tuple[str, ...]
    """Hypotheses in the order of its probabilities."""

    def start(self) -> Any:
        """Return the prior, an object with ``probabilities``."""
        ...

    def update_all(self, beliefs: Sequence[Any], records: RecordStatistics) -> list[Any]:
        """Update B beliefs with one record each, given as arrays (B, ...)."""
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
    return None if row[0] < 0.5 else records_from(layout, row[None])[0]


def records_from(layout: ObservationLayout, rows: NDArray[np.float32]) -> RecordStatistics:
    """Decode the statistics of B records from their slots (B, slot size), none of them empty."""
    at = layout.groups_of(rows)
    arm = layout.arm
    n, d = arm.n, len(arm.axes)
    rms = at["tool_rms"]
    covariance = rms[:, :, None] ** 2 * np.eye(d)
    i, j = np.triu_indices(d, 1)
    covariance[:, i, j] = at["tool_correlation"] * rms[:, i] * rms[:, j]
    covariance[:, j, i] = covariance[:, i, j]
    products = np.zeros((len(rows), d, d))
    products[:, *np.triu_indices(d)] = at["lowest_direction"]
    products += np.triu(products, 1).mT
    several: dict[str, Any] = {
        **{name: at[name] for name in ("pose", "joint_rms", "inertia", "skewness", "kurtosis")},
        **{name: at[name][:, 0] for name in ("duration", "lowest_skewness", "lowest_kurtosis")},
        **{name: at[name].reshape(-1, n, d).mT for name in _TRANSMISSIONS},
        "torque": at["torque"] * np.array(arm.torque_limits),
        "tool_covariance": covariance,
        "lowest_direction": np.linalg.eigh(products)[1][..., -1],
        "lowest_coherence": at["coherence"][:, 0],
        "maximum_correlation": at["correlation"][:, 0],
    }
    return RecordStatistics(**several)


_TRANSMISSIONS = ("transmission", "transmission_by_instrument")


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
    """Numbers (..., size) that a policy sees of posteriors (..., hypotheses).

    One after the other: the probabilities of the hypotheses; their logarithms (the natural ones,
    those below 1e-6 cut off, divided by 7); the largest probability; the logarithm of what is
    left beside it, from 0 to 1 at 0.1 %; the entropy as a share of the largest possible; the
    observation's global elements ``start``.
    """
    p = np.asarray(probabilities, dtype=float)
    logs = np.log(np.maximum(p, PROBABILITY_FLOOR)) / 7.0
    entropy = -np.sum(p * np.log(np.maximum(p, 1e-12)), axis=-1) / np.log(max(p.shape[-1], 2))
    most = p.max(axis=-1)
    doubt = np.log(np.maximum(1 - most, 1e-3)) / np.log(1e-3)
    return np.concatenate([p, logs, np.stack([most, doubt, entropy], axis=-1), start], axis=-1)


def taken_in(
    posterior: Posterior,
    layout: ObservationLayout,
    observations: NDArray[np.float32],
    beliefs: Sequence[Any],
    known: IndexArray,
) -> tuple[list[Any], IndexArray]:
    """Beliefs after the records in observations (A, size), of which the first are ``known`` (A,).

    Returned with the number of records that are in them.
    """
    slots, taken, after = layout.slots_of(observations), layout.records_of(observations), [*beliefs]
    for step in range(int((taken - known).max(initial=0))):
        k = np.minimum(known + step, slots.shape[1] - 1)
        rows = np.arange(len(slots))
        new = np.flatnonzero((known + step < taken) & (slots[rows, k, 0] > 0.5))
        if len(new):
            records = records_from(layout, slots[new, k[new]])
            found = posterior.update_all([after[i] for i in new], records)
            for i, belief in zip(new, found, strict=True):
                after[i] = belief
    return after, taken


def checked_order(posterior: Posterior, hypotheses: Sequence[str]) -> list[int]:
    """Place of each hypothesis among the posterior's; refused where it lacks one."""
    known = posterior.hypotheses
    unknown = [name for name in hypotheses if name not in known]
    if unknown:
        raise InvalidSetting(f"the posterior knows nothing of {unknown}; it knows {list(known)}")
    return [known.index(name) for name in hypotheses]
