"""Fits the in-distribution reference used by `NoveltyReference`.

Only arms of the trained kind are shown to it. The mixtures are fitted to episodes that the
network was trained on, the table of scores comes from episodes that neither has seen.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loose_agents.core.base import Problem
from loose_agents.posterior_training.record_bank import RecordBank
from loose_env.diagnosis import (
    NOVELTY_STATISTICS,
    REFERENCE,
    AmortisedBelief,
    NoveltyReference,
    SeatFeatures,
    SeatNetwork,
    Seen,
    used_columns,
)
from loose_env.errors import InvalidData
from loose_env.statistics import fit_gaussian_mixture
from loose_env.typing import Array

__all__ = ["NoveltySettings", "episode_sights", "fit_reference", "seen_episodes", "with_reference"]

_RARE = 0.99  # what one episode in a hundred exceeds
_EVEN = 1e-3  # spread of scores that are all alike


@dataclass(frozen=True, kw_only=True)
class NoveltySettings:
    """Settings of the reference fit."""

    components: int = 12
    """Gaussians of each mixture."""
    fitted: int = 2000
    """Episodes that the mixtures are fitted to, at most."""
    points: int = 15_000
    """Records of theirs, each counted anew after every further record, at most."""
    ranked: int = 2500
    """Held-out episodes in the table of scores, at most."""
    tables: int = 5
    """Tables of scores: after 1, 2, ... records; the last is for so many or more."""
    regularisation: float = 1e-3
    """Added to the variances of scaled features."""
    seed: int = 1
    """Seed of the mixtures' start, and of which records they are fitted to."""


def seen_episodes(
    problem: Problem, features: SeatFeatures, bank: RecordBank
) -> Iterator[list[Seen]]:
    """Iterate over the episodes of a bank that have records, with their statistics.

    Parameters
    ----------
    problem : Problem
        Arm and rules of the bank.
    features : SeatFeatures
        Feature extractor.
    bank : RecordBank
        The episodes.
    """
    for records in bank.records(problem.layout):
        seen = [Seen(*features.with_change(record)) for record in records if record is not None]
        if seen:
            yield seen


def episode_sights(
    network: SeatNetwork,
    seen: Sequence[Seen],
    *,
    directions: Array,
    prior: Array,
    counts: Sequence[int],
) -> list[Array]:
    """Novelty statistics of an episode after a number of records.

    Parameters
    ----------
    network : SeatNetwork
        The trained network.
    seen : sequence of Seen
        What its records showed.
    directions : ndarray (A, axes)
        Sliding directions of a link.
    prior : ndarray (1 + 2 n,)
        Log-probability of the hypotheses beforehand.
    counts : sequence of int
        Numbers of records.

    Returns
    -------
    list of ndarray (records, columns)
        For each number, what `loose_env.diagnosis.novelty.sights` gives.
    """
    n = (len(prior) - 1) // 2
    hypothesis = np.concatenate([np.repeat(np.arange(n), len(directions)), n + np.arange(n)])
    total = np.cumsum([network.likelihood(s.location, s.record, hypothesis) for s in seen], axis=0)
    return [
        AmortisedBelief(
            total=total[records - 1],
            records=records,
            temper=network.temper(records),
            prior=prior,
            directions=directions,
            hypothesis=hypothesis,
            seen=tuple(seen[:records]),
        ).sights
        for records in counts
    ]


def fit_reference(
    tensors: Mapping[str, NDArray[Any]],
    trained: Iterable[Sequence[Seen]],
    held: Iterable[Sequence[Seen]],
    *,
    directions: Array,
    settings: NoveltySettings | None = None,
) -> NoveltyReference:
    """Fit the mixtures and rank the held-out episodes.

    Parameters
    ----------
    tensors : mapping of str to ndarray
        The trained network.
    trained, held : iterable of sequences of Seen
        Episodes to fit to, and others for the tables.
    directions : ndarray (A, axes)
        Sliding directions of a link.
    settings : NoveltySettings, optional
        How it is done.

    Raises
    ------
    InvalidData
        If there are no episodes with records.
    """
    s = NoveltySettings() if settings is None else settings
    network = SeatNetwork(tensors)
    n = network.sizes["H"] // 2
    third = np.log(1 / 3)
    prior = np.concatenate([[third], np.full(2 * n, third - np.log(n))])

    def sights_of(episodes: Iterable[Sequence[Seen]], most: int) -> list[list[Array]]:
        """Novelty statistics of each episode, by number of records."""
        found: list[list[Array]] = [[] for _ in range(s.tables)]
        for _, seen in zip(range(most), episodes, strict=False):
            counts = range(1, len(seen) + 1)
            for columns in episode_sights(
                network, seen, directions=directions, prior=prior, counts=counts
            ):
                found[min(len(columns), s.tables) - 1].append(columns)
        return [each for each in found if each]

    fitted, ranked = sights_of(trained, s.fitted), sights_of(held, s.ranked)
    if not fitted or not ranked:
        raise InvalidData("no episode has a record: nothing to fit to, or to rank new ones among")
    tables = min(len(fitted), len(ranked))
    points = np.concatenate([columns for each in fitted for columns in each])
    mean, scale = points.mean(0), points.std(0) + 1e-6
    rng = np.random.default_rng(s.seed)
    scaled = (points[rng.permutation(len(points))[: s.points]] - mean) / scale
    mixtures = tuple(
        fit_gaussian_mixture(
            scaled[:, used_columns(name)], s.components, rng, regularisation=s.regularisation
        )
        for name in NOVELTY_STATISTICS
    )
    level = np.zeros((tables, len(NOVELTY_STATISTICS)))
    plain = NoveltyReference(
        mean=mean,
        scale=scale,
        mixtures=mixtures,
        usual=level,
        spread=level + 1.0,
        scores=tuple(np.zeros(1) for _ in range(tables)),
    )
    usual, spread = level.copy(), level.copy()
    for k, episodes in enumerate(fitted[:tables]):
        means = np.stack([plain.novelty(columns).mean(0) for columns in episodes])
        usual[k] = np.median(means, axis=0)
        spread[k] = np.maximum(np.quantile(means, _RARE, axis=0) - usual[k], _EVEN)
    # Ranked is what will be read again, not what was rounded when it was stored.
    read = NoveltyReference.of(_rounded(replace(plain, usual=usual, spread=spread)))
    scores = tuple(
        np.sort([read.score(read.novelty(columns)) for columns in episodes])
        for episodes in ranked[:tables]
    )
    return replace(read, scores=tuple(each.astype(np.float32).astype(float) for each in scores))


def with_reference(
    tensors: Mapping[str, NDArray[Any]], reference: NoveltyReference
) -> dict[str, NDArray[Any]]:
    """Store a reference beside a network's tensors, replacing an existing one."""
    kept = {name: values for name, values in tensors.items() if not name.startswith(REFERENCE)}
    return kept | {REFERENCE + name: values for name, values in _rounded(reference).items()}


def _rounded(reference: NoveltyReference) -> dict[str, NDArray[np.float32]]:
    return {name: values.astype(np.float32) for name, values in reference.tensors().items()}
