"""Novelty test of an episode: statistics of its records, training mixture, conformal p-value.

Every posterior adds up to one, also where none of its hypotheses is true: two faults at once, an
arm that is no draw of the nominal one. Three statistics can give such an arm away: the change of
motion that even the favoured locations leave unexplained, how much of that one second seat would
explain in all records alike, and motion that is heavier on one side than on the other, as that
of a seat which a load presses on one of its stops. How large each is on arms of the trained
kind, given what was excited, how hard and what is believed, is learned as a Gaussian mixture;
nothing else is shown to it. The whole episode is then ranked among held-out episodes of the
trained kind by the figure that stands out most (conformal prediction: Vovk, Gammerman and Shafer,
Algorithmic Learning in a Random World, 2005, 4.1). One rank of the largest needs no correction
for there being several, and is a p-value whatever the mixtures get wrong.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, ndtri_exp

from loose_env.diagnosis.features import (
    LOCATION_FEATURES,
    RECORD_FEATURES,
    TransmissionChange,
)
from loose_env.errors import InvalidData
from loose_env.statistics import GaussianMixture
from loose_env.typing import Array

MODEL_SHARE = 0.01
"""Errors beyond the first order, as a share of the arm's own in-step motion [1]."""
SEAT_SHARE = 0.05
"""Errors of a seat's motion, as a share of it [1]: half the step between 24 directions is 3.75
degrees, 6.5 % of the motion at most, 3.8 % rms."""
_WIDEST = (-0.5, 1.5)  # how far a seat opens: below none or above all of it by errors only
_TURNS = 2  # the room of a seat's motion depends on how far it opens, which depends on the room


@dataclass(frozen=True, kw_only=True, eq=False)
class ResidualChange:
    """One record's change under every location."""

    healthy: float
    """chi² of the change on a healthy arm."""
    residual: Array
    """Residual chi² of each location (P,)."""
    explained: Array
    """chi² explained by each location (P,)."""
    opening: Array
    """Fitted opening of each location, 1: floats freely (P,)."""
    measured: Array
    """The change along uncorrelated directions [m/s²] (K,)."""
    open: Array
    """The same of each location that floats freely (P, K)."""
    variance: Array
    """Variance along them for each location [m²/s⁴] (P, K)."""

    def second(self, first: int) -> Array:
        """Decrease of the log residual by a second seat beside the first, by location (P,)."""
        sd = np.sqrt(self.variance[first])
        along, others = self.open[first] / sd, self.open / sd
        rest = self.measured / sd - self.opening[first] * along
        length = float(np.linalg.norm(along))
        along = along / length if length > 0 else along
        # The first may open otherwise beside a second one: only what lies across it counts.
        rest = rest - (rest @ along) * along
        others = others - np.outer(others @ along, along)
        left = float(rest @ rest)
        gain = (others @ rest) ** 2 / ((others**2).sum(1) + 1.0)
        return np.asarray(np.log((left + 1.0) / (np.maximum(left - gain, 0.0) + 1.0)))


def residual_change(change: TransmissionChange) -> ResidualChange:
    """Set one record's change against every location.

    Errors of model and sampling are known to first order only, and along some directions that
    leaves next to nothing: there errors of second order, the steps between the directions that are
    tried and the seat's own nonlinearity would look like a change. So each has room of its own, in
    shares of the motion.
    """
    assert change.covariance is not None
    size, axes = np.linalg.eigh(change.covariance)
    measured, opened = axes.T @ change.measured, change.open @ axes
    count = len(measured)
    base = np.maximum(size, 0.0) + MODEL_SHARE**2 * float(change.nominal @ change.nominal) / count
    power = (change.open**2).sum(1) / count
    variance = np.broadcast_to(base, opened.shape)
    opening, visible = _opening(measured, opened, variance)
    for _ in range(_TURNS):
        variance = base + (SEAT_SHARE**2 * opening**2 * power)[:, None]
        opening, visible = _opening(measured, opened, variance)
    rest = measured - opening[:, None] * opened
    return ResidualChange(
        healthy=float((measured**2 / base).sum()),
        residual=(rest**2 / variance).sum(1) + opening**2,
        explained=opening**2 * visible,
        opening=opening,
        measured=measured,
        open=opened,
        variance=variance,
    )


def _opening(measured: Array, opened: Array, variance: Array) -> tuple[Array, Array]:
    """Fitted opening of each location, and the chi² of it floating freely (P,)."""
    visible = (opened**2 / variance).sum(1)
    opening = (opened * measured / variance).sum(1) / (visible + 1.0)
    return np.clip(opening, *_WIDEST), visible


NOVELTY_STATISTICS = ("left", "second", "one_sided")
"""Test statistics: log residual chi², its reduction by a second seat, skewness."""
_PLACE = ("visible", "inertia_visible", "drive", "load", "loose_expected")
_RECORD = ("numbers", "level", "excited", "duration")
CONTEXT = (*_PLACE, *_RECORD, "healthy", "records", "explained", "opening")
"""Context of the statistics: features of the best locations and of the record, log-odds of
a healthy arm, log of the number of records, chi² explained by the locations and their opening."""
_SHAPE = ("kurtosis", "lowest_kurtosis")
COLUMNS = (*NOVELTY_STATISTICS, *CONTEXT, *_SHAPE)
"""Columns that `sights` gives."""

_PLACE_AT = [LOCATION_FEATURES.index(name) for name in _PLACE]
_RECORD_AT = [RECORD_FEATURES.index(name) for name in _RECORD]
_SHAPE_AT = [RECORD_FEATURES.index(name) for name in _SHAPE]
_SKEW = RECORD_FEATURES.index("skewness")
_CONTEXT_AT = [COLUMNS.index(name) for name in CONTEXT]
_USED = {
    "left": [COLUMNS.index("left"), *_CONTEXT_AT],
    "second": [COLUMNS.index("second"), *_CONTEXT_AT],
    # Impacts make a record heavy-tailed, and what is heavy-tailed is skew by chance.
    "one_sided": [COLUMNS.index(x) for x in ("one_sided", *CONTEXT, *_SHAPE)],
}
"""Columns of each statistic's mixture, the statistic first."""
_FINEST = 0.1  # chi² below which a change is no change at all
_SUREST = 10.0  # log-odds beyond which a posterior says no more
_LARGEST = 30.0  # standard deviations beyond which all is alike


@dataclass(frozen=True, eq=False)
class Seen:
    """Features of one record."""

    location: Array
    """Features of the locations, `LOCATION_FEATURES` (P, C)."""
    record: Array
    """Features of the record, `RECORD_FEATURES` (Q,)."""
    change: TransmissionChange
    """The change of motion behind them."""

    @cached_property
    def residual_change(self) -> ResidualChange:
        """The change under every location; worked out when it is asked for."""
        return residual_change(self.change)


def sights(
    seen: Sequence[Seen], weights: Array, healthy: float, hypothesis: NDArray[np.intp]
) -> Array:
    """Statistics of the novelty test of R records, with their context (R, `COLUMNS`).

    Under the probability of each location (P,) if one of them is loose, and the log-odds of a
    healthy arm, both after all records.
    """
    found = [each.residual_change for each in seen]
    record = np.stack([each.record for each in seen])
    locations = np.stack([weights @ each.location for each in seen])
    loose, intact = expit(-healthy), expit(healthy)
    left = np.stack([loose * (weights @ np.log(f.residual + _FINEST)) for f in found])
    left = left + intact * np.log(np.array([f.healthy for f in found]) + _FINEST)
    first = int(np.argmax(weights))
    second = np.mean([f.second(first) for f in found], axis=0)
    second = float(second[hypothesis != hypothesis[first]].max(initial=0.0))
    explained = loose * np.array([weights @ np.log1p(f.explained) for f in found])
    opening = loose * np.array([weights @ f.opening for f in found])
    count = len(found)
    return np.column_stack(
        [
            left,
            np.full(count, second),
            record[:, _SKEW],
            locations[:, _PLACE_AT],
            record[:, _RECORD_AT],
            np.full(count, np.clip(healthy, -_SUREST, _SUREST)),
            np.full(count, np.log(count)),
            explained,
            opening,
            record[:, _SHAPE_AT],
        ]
    )


def conformal_p(score: float, scores: Array) -> float:
    """Share of held-out scores, in increasing order, that are as large, the new one among them."""
    larger = len(scores) - int(np.searchsorted(scores, score, side="left"))
    return (1 + larger) / (1 + len(scores))


@dataclass(frozen=True, kw_only=True, eq=False)
class NoveltyReference:
    """Distribution of the statistics on arms of the trained kind.

    Tables are by number of records: 1, 2, ...; the last serves longer episodes too.
    """

    mean: Array
    """Centre of the columns that `sights` gives (D,)."""
    scale: Array
    """Their scale (D,)."""
    mixtures: tuple[GaussianMixture, ...]
    """Scaled density of each statistic and its context, in the order of `NOVELTY_STATISTICS`."""
    usual: Array
    """Median of an episode's mean novelty by number of records (K, statistics)."""
    spread: Array
    """Excess of the 99th percentile over it (K, statistics)."""
    scores: tuple[Array, ...] = ()
    """Scores of held-out episodes, each in increasing order, by number of records."""

    def novelty(self, columns: Array) -> Array:
        """Normal deviate of the chance of more, given the context (N, statistics)."""
        scaled = (columns - self.mean) / self.scale
        tails = [
            mixture.log_upper_tail(scaled[:, _USED[name]])
            for name, mixture in zip(NOVELTY_STATISTICS, self.mixtures, strict=True)
        ]
        deviates = -ndtri_exp(np.minimum(np.column_stack(tails), 0.0))
        return np.asarray(np.clip(deviates, -_LARGEST, _LARGEST))

    def score(self, novelty: Array) -> float:
        """Novelty score of an episode: its largest over the statistics, mean over records."""
        at = min(len(novelty), len(self.usual)) - 1
        return float(((novelty.mean(0) - self.usual[at]) / self.spread[at]).max())

    def surprise(self, novelty: Array) -> float:
        """p-value of an episode among those of the trained kind; one without records."""
        if not len(novelty):
            return 1.0
        return conformal_p(
            self.score(novelty), self.scores[min(len(novelty), len(self.scores)) - 1]
        )

    def tensors(self) -> dict[str, NDArray[Any]]:
        """As it is stored beside a network, names without their prefix."""
        stored = {name: getattr(self, name) for name in ("mean", "scale", "usual", "spread")}
        for name, mixture in zip(NOVELTY_STATISTICS, self.mixtures, strict=True):
            for part in _MIXTURE:
                stored[f"{name}.{part}"] = getattr(mixture, part)
        return stored | {f"scores.{k}": each for k, each in enumerate(self.scores, start=1)}

    @classmethod
    def of(cls, tensors: Mapping[str, NDArray[Any]]) -> NoveltyReference:
        """Read what `tensors` gave; InvalidData if one is missing or of another shape."""
        wanted = ["mean", "scale", "usual", "spread", "scores.1"]
        wanted += [f"{name}.{part}" for name in NOVELTY_STATISTICS for part in _MIXTURE]
        missing = [name for name in wanted if name not in tensors]
        if missing:
            raise InvalidData(
                f"the reference of the trained kind lacks {missing}; train it again with "
                "scripts/agents/train_posterior.py"
            )
        found = {name: np.asarray(values, dtype=float) for name, values in tensors.items()}
        count = sum(name.startswith("scores.") for name in found)
        expected: dict[str, tuple[int, ...]] = {x: (len(COLUMNS),) for x in ("mean", "scale")}
        expected |= {name: (count, len(NOVELTY_STATISTICS)) for name in ("usual", "spread")}
        expected |= {
            f"{name}.means": (len(found[f"{name}.weights"]), len(used))
            for name, used in _USED.items()
        }
        wrong = [name for name, shape in expected.items() if found[name].shape != shape]
        if wrong:
            raise InvalidData(
                f"the reference of the trained kind has {wrong[0]!r} of shape "
                f"{found[wrong[0]].shape}, not {expected[wrong[0]]}: it belongs to another "
                "version; train it again with scripts/agents/train_posterior.py"
            )
        return cls(
            **{name: found[name] for name in ("mean", "scale", "usual", "spread")},
            mixtures=tuple(_mixture(found, name) for name in NOVELTY_STATISTICS),
            scores=tuple(np.sort(found[f"scores.{k}"]) for k in range(1, count + 1)),
        )


_MIXTURE = ("weights", "means", "covariances")


def _mixture(tensors: Mapping[str, Array], name: str) -> GaussianMixture:
    weights, means, covariances = (tensors[f"{name}.{part}"] for part in _MIXTURE)
    if not (np.isfinite(weights).all() and weights.sum() > 0):
        raise InvalidData(f"{name}.weights has to be finite with a positive sum")
    return GaussianMixture(weights=weights / weights.sum(), means=means, covariances=covariances)


def used_columns(name: str) -> list[int]:
    """Columns of a statistic's mixture, the statistic first."""
    return list(_USED[name])
