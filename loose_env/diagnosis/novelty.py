"""Whether an episode's records look like those that a learned likelihood was trained on.

Every posterior adds up to one, also where none of its hypotheses is true: two faults at once, an
arm that is no draw of the nominal one. What gives such an arm away is the change of motion that
even the favoured places leave unexplained, record by record. How large it is on arms of the
trained kind, given what was excited and how hard, is learned as a Gaussian mixture; nothing else
is shown to it. The whole episode is then ranked among held-out episodes of the trained kind
(conformal prediction: Vovk, Gammerman and Shafer, Algorithmic Learning in a Random World, 2005,
4.1), which makes the rank a p-value whatever the mixture gets wrong.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri_exp

from loose_env.diagnosis.seat_features import PLACE_FEATURES, RECORD_FEATURES
from loose_env.errors import InvalidData
from loose_env.statistics.gaussian_mixture import GaussianMixture

__all__ = ["CONTEXT", "NoveltyReference", "conformal_p", "left_over"]

Array = NDArray[np.float64]

_PLACE = ("visible", "inertia_visible", "drive", "load", "loose_expected")
_RECORD = ("numbers", "level", "excited", "duration")
CONTEXT = (*_PLACE, *_RECORD, "healthy", "records")
"""What the change left unexplained is judged by: figures of the favoured places and of the
record, log-odds of a sound arm, log of the number of records."""

_PLACE_AT = [PLACE_FEATURES.index(name) for name in _PLACE]
_RECORD_AT = [RECORD_FEATURES.index(name) for name in _RECORD]
_LEFT = PLACE_FEATURES.index("left")
_FINEST = 0.1  # chi² below which a change is no change at all
_SUREST = 10.0  # log-odds beyond which a posterior says no more
_LARGEST = 30.0  # standard deviations beyond which all is alike


def left_over(place: Array, record: Array, weights: Array, healthy: float) -> Array:
    """What is left unexplained of each record, and what it is to be judged by.

    Parameters
    ----------
    place : ndarray (R, P, C)
        Figures of the places, `PLACE_FEATURES`.
    record : ndarray (R, Q)
        Figures of the records, `RECORD_FEATURES`.
    weights : ndarray (P,)
        Probability of each place after all of these records, if one of them is loose; they add
        up to one.
    healthy : float
        Log-odds of a sound arm.

    Returns
    -------
    ndarray (R, 1 + len(CONTEXT))
        Log of the chi² that the favoured places leave, then `CONTEXT`.
    """
    mean = np.einsum("p,rpc->rc", weights, place)
    left = np.log(np.expm1(np.clip(mean[:, _LEFT], 0.0, 60.0)) + _FINEST)
    count = len(record)
    whole = np.full((count, 2), [np.clip(healthy, -_SUREST, _SUREST), np.log(max(count, 1))])
    return np.concatenate([left[:, None], mean[:, _PLACE_AT], record[:, _RECORD_AT], whole], axis=1)


def conformal_p(score: float, scores: Array) -> float:
    """Share of held-out scores that are as large, the new one counted among them.

    Uniform, or larger, where the new one comes from where they do.

    Parameters
    ----------
    score : float
        The new one.
    scores : ndarray (N,)
        Of held-out episodes, in increasing order.

    Examples
    --------
    >>> conformal_p(2.5, np.array([1.0, 2.0, 3.0])), conformal_p(9.0, np.array([1.0, 2.0, 3.0]))
    (0.5, 0.25)
    """
    larger = len(scores) - int(np.searchsorted(scores, score, side="left"))
    return (1 + larger) / (1 + len(scores))


@dataclass(frozen=True, kw_only=True, eq=False)
class NoveltyReference:
    """What is left unexplained on arms of the trained kind.

    Examples
    --------
    >>> size = 1 + len(CONTEXT)
    >>> reference = NoveltyReference(
    ...     mean=np.zeros(size),
    ...     scale=np.ones(size),
    ...     mixture=GaussianMixture(
    ...         weights=np.ones(1), means=np.zeros((1, size)), covariances=np.eye(size)[None]
    ...     ),
    ...     scores=(np.linspace(-2.0, 2.0, 99),),
    ... )
    >>> reference.novelty(2.0 * np.eye(size)[:1]).round(3).tolist()
    [2.0]
    >>> reference.surprise([-3.0]), reference.surprise([5.0])
    (1.0, 0.01)
    """

    mean: Array
    """Centre of the figures that `left_over` gives (D,)."""
    scale: Array
    """Their scale (D,)."""
    mixture: GaussianMixture
    """Density of them, centred and scaled."""
    scores: tuple[Array, ...]
    """Mean novelty of held-out episodes after 1, 2, ... records, each in increasing order; the
    last serves longer episodes too."""

    def novelty(self, figures: Array) -> Array:
        """By how much more is left than is usual, in standard deviations of a normal variable.

        Parameters
        ----------
        figures : ndarray (N, D)
            What `left_over` gives.

        Returns
        -------
        ndarray (N,)
            Normal deviate of the chance that more is left.
        """
        log_tail = self.mixture.log_upper_tail((figures - self.mean) / self.scale)
        return np.asarray(np.clip(-ndtri_exp(np.minimum(log_tail, 0.0)), -_LARGEST, _LARGEST))

    def surprise(self, novelty: Sequence[float] | Array) -> float:
        """p-value of an episode among those of the trained kind; one without records.

        Parameters
        ----------
        novelty : sequence of float
            Of all of its records.
        """
        if not len(novelty):
            return 1.0
        table = self.scores[min(len(novelty), len(self.scores)) - 1]
        return conformal_p(float(np.mean(novelty)), table)

    def tensors(self) -> dict[str, NDArray[Any]]:
        """As it is stored beside a network, names without their prefix."""
        return {
            "mean": self.mean,
            "scale": self.scale,
            "weights": self.mixture.weights,
            "means": self.mixture.means,
            "covariances": self.mixture.covariances,
            **{f"scores.{k}": each for k, each in enumerate(self.scores, start=1)},
        }

    @classmethod
    def of(cls, tensors: Mapping[str, NDArray[Any]]) -> NoveltyReference:
        """Read what `tensors` gave.

        Raises
        ------
        InvalidData
            If a tensor is missing or of another shape.
        """
        wanted = ("mean", "scale", "weights", "means", "covariances", "scores.1")
        missing = [name for name in wanted if name not in tensors]
        if missing:
            raise InvalidData(
                f"the reference of the trained kind lacks {missing}; work it out again with "
                "scripts/train_posterior.py --reference-only"
            )
        found = {name: np.asarray(values, dtype=float) for name, values in tensors.items()}
        size = 1 + len(CONTEXT)
        shapes = {found["mean"].shape, found["scale"].shape, found["means"].shape[1:]}
        if shapes != {(size,)}:
            raise InvalidData(
                f"the reference of the trained kind has figures of shape {sorted(shapes)}, "
                f"not ({size},): it belongs to another version; work it out again with "
                "scripts/train_posterior.py --reference-only"
            )
        weights = found["weights"]
        count = sum(name.startswith("scores.") for name in found)
        return cls(
            mean=found["mean"],
            scale=found["scale"],
            mixture=GaussianMixture(
                weights=weights / weights.sum(),
                means=found["means"],
                covariances=found["covariances"],
            ),
            scores=tuple(np.sort(found[f"scores.{k}"]) for k in range(1, count + 1)),
        )
