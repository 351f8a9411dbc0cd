"""Works out what the records of trained-kind arms leave unexplained, for `NoveltyReference`.

Only arms of the trained kind are shown to it. The mixture is fitted to episodes that the network
was trained on, the table of scores comes from episodes that neither has seen.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from agents.place_figures import PlaceFigures
from loose_env.diagnosis.amortised import REFERENCE, AmortisedBelief
from loose_env.diagnosis.novelty import NoveltyReference, left_over
from loose_env.diagnosis.seat_network import SeatNetwork
from loose_env.errors import InvalidData
from loose_env.statistics.gaussian_mixture import fit_gaussian_mixture

__all__ = ["NoveltySettings", "episode_figures", "fit_reference", "with_reference"]

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class NoveltySettings:
    """How the reference is worked out."""

    components: int = 5
    """Gaussians of the mixture."""
    fitted: int = 4000
    """Episodes that it is fitted to, at most."""
    ranked: int = 4000
    """Held-out episodes in the table of scores, at most."""
    tables: int = 5
    """Tables of scores: after 1, 2, ... records; the last is for so many or more."""
    regularisation: float = 1e-3
    """Added to the variances of scaled figures."""
    seed: int = 1
    """Seed of the start, and of where episodes are cut."""


def episode_figures(
    network: SeatNetwork,
    figures: PlaceFigures,
    *,
    directions: Array,
    prior: Array,
    episode: int,
    counts: tuple[int, ...],
) -> list[Array]:
    """What is left unexplained of an episode after so many of its records.

    Parameters
    ----------
    network : SeatNetwork
        The trained network.
    figures : PlaceFigures
        Figures of the bank.
    directions : ndarray (A, axes)
        Sliding directions of a link.
    prior : ndarray (1 + 2 n,)
        Log-probability of the hypotheses beforehand.
    episode : int
        Which episode.
    counts : tuple of int
        Numbers of records, in increasing order.

    Returns
    -------
    list of ndarray (records, D)
        For each number, what `left_over` gives.
    """
    n = (len(prior) - 1) // 2
    count = len(directions)
    hypothesis = np.concatenate([np.repeat(np.arange(n), count), n + np.arange(n)])
    first = int(figures.first[episode])
    rows = slice(first, first + counts[-1])
    place, whole = figures.place[rows].astype(float), figures.record[rows].astype(float)
    each = [network.likelihood(p, w, hypothesis) for p, w in zip(place, whole, strict=True)]
    total = np.cumsum(each, axis=0)
    found = []
    for records in counts:
        belief = AmortisedBelief(
            total=total[records - 1],
            records=records,
            temper=network.temper(records),
            prior=prior,
            directions=directions,
        ).belief
        log = np.asarray(logsumexp(belief.loose[0], axis=1))
        loose = float(logsumexp(log))
        found.append(
            left_over(
                place[:records], whole[:records], np.exp(log - loose), float(prior[0]) - loose
            )
        )
    return found


def fit_reference(
    tensors: Mapping[str, NDArray[Any]],
    trained: PlaceFigures,
    held: PlaceFigures,
    *,
    directions: Array,
    settings: NoveltySettings | None = None,
) -> NoveltyReference:
    """Fit the mixture, rank the held-out episodes.

    Parameters
    ----------
    tensors : mapping of str to ndarray
        The trained network.
    trained, held : PlaceFigures
        Episodes to fit to, and others for the tables.
    directions : ndarray (A, axes)
        Sliding directions of a link.
    settings : NoveltySettings, optional
        How it is done.

    Raises
    ------
    InvalidData
        If there are too few episodes with records.
    """
    s = NoveltySettings() if settings is None else settings
    network = SeatNetwork(tensors)
    n = network.sizes["H"] // 2
    third = np.log(1 / 3)
    prior = np.concatenate([[third], np.full(2 * n, third - np.log(n))])
    rng = np.random.default_rng(s.seed)

    def figures_at(bank: PlaceFigures, episode: int, counts: tuple[int, ...]) -> list[Array]:
        return episode_figures(
            network, bank, directions=directions, prior=prior, episode=episode, counts=counts
        )

    chosen = np.flatnonzero(trained.count > 0)[: s.fitted]
    # Cut at random, so that every number of records is learned.
    cuts = 1 + rng.integers(trained.count[chosen])
    parts = [figures_at(trained, int(e), (int(c),))[0] for e, c in zip(chosen, cuts, strict=True)]
    points = np.concatenate(parts) if parts else np.zeros((0, 1))
    mean, scale = points.mean(0), points.std(0) + 1e-6
    mixture = fit_gaussian_mixture(
        (points - mean) / scale, s.components, rng, regularisation=s.regularisation
    )
    reference = NoveltyReference(mean=mean, scale=scale, mixture=mixture, scores=())
    scores: list[list[float]] = [[] for _ in range(s.tables)]
    for episode in np.flatnonzero(held.count > 0)[: s.ranked]:
        counts = tuple(range(1, int(held.count[episode]) + 1))
        for found in figures_at(held, int(episode), counts):
            at = min(len(found), s.tables) - 1
            scores[at].append(float(reference.novelty(found).mean()))
    tables = [np.sort(np.asarray(each, dtype=np.float32)) for each in scores if each]
    if not tables:
        raise InvalidData("no held-out episode has a record: nothing to rank new ones among")
    return NoveltyReference(
        mean=mean, scale=scale, mixture=mixture, scores=tuple(t.astype(float) for t in tables)
    )


def with_reference(
    tensors: Mapping[str, NDArray[Any]], reference: NoveltyReference
) -> dict[str, NDArray[Any]]:
    """Put a reference beside a network's tensors, in place of one that was there."""
    kept = {name: values for name, values in tensors.items() if not name.startswith(REFERENCE)}
    stored = {
        name: values.astype(np.float32) if name.startswith("scores.") else values
        for name, values in reference.tensors().items()
    }
    return kept | {REFERENCE + name: values for name, values in stored.items()}
