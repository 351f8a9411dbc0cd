"""Novelty of episodes: p-values, and what a seat leaves unexplained of a change."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from loose_env.diagnosis import (
    NOVELTY_STATISTICS,
    NoveltyReference,
    used_columns,
)
from loose_env.diagnosis.features import (
    TransmissionChange,
)
from loose_env.diagnosis.novelty import (
    COLUMNS,
    MODEL_SHARE,
    residual_change,
)
from loose_env.errors import InvalidData
from loose_env.statistics import fit_gaussian_mixture

SIZE = len(COLUMNS)
FIRST = len(NOVELTY_STATISTICS)  # where the context begins


def made(rng: np.random.Generator, count: int) -> np.ndarray:
    """Columns of records in which every figure grows with the context."""
    rest = rng.normal(size=(count, SIZE - FIRST))
    figures = 2.0 * rest[:, :1] - rest[:, 3:4] + 0.5 * rng.normal(size=(count, FIRST))
    return np.column_stack([figures, rest])


def episodes(
    reference: NoveltyReference, rng: np.random.Generator, count: int, records: int
) -> np.ndarray:
    """Novelty of the records of some episodes (count, records, statistics)."""
    return reference.novelty(made(rng, count * records)).reshape(count, records, -1)


@pytest.fixture(scope="module")
def reference() -> NoveltyReference:
    rng = np.random.default_rng(0)
    points = made(rng, 3000)
    first = NoveltyReference(
        mean=np.zeros(SIZE),
        scale=np.ones(SIZE),
        mixtures=tuple(
            fit_gaussian_mixture(points[:, used_columns(name)], 2, rng)
            for name in NOVELTY_STATISTICS
        ),
        usual=np.zeros((2, FIRST)),
        spread=np.ones((2, FIRST)),
    )
    tables = tuple(np.sort([first.score(e) for e in episodes(first, rng, 999, k)]) for k in (1, 2))
    return replace(first, scores=tables)


@pytest.mark.parametrize("records", [1, 2])
def test_p_values_of_the_trained_kind_are_uniform(
    reference: NoveltyReference, records: int
) -> None:
    rng = np.random.default_rng(1)
    found = [reference.surprise(each) for each in episodes(reference, rng, 2000, records)]
    for level in (0.02, 0.1, 0.5, 0.9):
        spread = 4 * np.sqrt(level * (1 - level) * (1 / 2000 + 1 / 1000))
        assert np.mean(np.array(found) <= level) == pytest.approx(level, abs=spread)


@pytest.mark.parametrize("figure", range(FIRST))
def test_each_figure_is_judged_by_its_context(reference: NoveltyReference, figure: int) -> None:
    usual = made(np.random.default_rng(2), 1)
    usual[0, FIRST], usual[0, FIRST + 3] = 3.0, 0.0
    usual[0, :FIRST] = 6.0  # large, and no more than such a context explains
    assert np.abs(reference.novelty(usual)).max() < 1.0
    assert reference.surprise(reference.novelty(usual)) > 0.1
    usual[0, figure] += 6.0
    novelty = reference.novelty(usual)[0]
    assert novelty[figure] > 5.0
    assert np.abs(np.delete(novelty, figure)).max() < 1.0
    assert reference.surprise(novelty[None]) == 1 / 1000


def test_the_last_table_serves_longer_episodes(reference: NoveltyReference) -> None:
    assert reference.surprise(np.ones((7, FIRST))) == reference.surprise(np.ones((2, FIRST)))
    assert reference.surprise(np.zeros((0, FIRST))) == 1.0


def test_it_is_stored_and_read_again(reference: NoveltyReference) -> None:
    again = NoveltyReference.of(reference.tensors())
    points = made(np.random.default_rng(3), 5)
    assert again.novelty(points) == pytest.approx(reference.novelty(points))
    one = np.full((1, FIRST), 0.4)
    assert again.surprise(one) == reference.surprise(one)
    some = {k: v for k, v in reference.tensors().items() if k != "second.means"}
    with pytest.raises(InvalidData, match=r"lacks.*second.means"):
        NoveltyReference.of(some)
    for name in ("mean", "spread"):
        with pytest.raises(InvalidData, match="another version"):
            NoveltyReference.of(reference.tensors() | {name: np.zeros(4)})


ELEMENTS, PLACES = 8, 6


def change(
    rng: np.random.Generator,
    openings: dict[int, float],
    *,
    error: float = 0.0,
    thin: float = 1e-2,
) -> TransmissionChange:
    """Make a change by some seats, in an arm with a direction along which errors are thin."""
    opened = rng.normal(size=(PLACES, ELEMENTS))
    axes = np.linalg.qr(rng.normal(size=(ELEMENTS, ELEMENTS)))[0]
    sd = np.full(ELEMENTS, 0.05)
    sd[0] = thin
    nominal = 3.0 * rng.normal(size=ELEMENTS)
    measured = axes @ (sd * rng.normal(size=ELEMENTS)) + error * nominal
    for place, opening in openings.items():
        measured = measured + opening * opened[place]
    return TransmissionChange(
        measured=measured,
        open=opened,
        nominal=nominal,
        covariance=axes @ np.diag(sd**2) @ axes.T,
    )


def test_the_seat_that_moved_leaves_little_and_opens_as_it_did() -> None:
    rng = np.random.default_rng(1)
    left, opening = [], []
    for _ in range(200):
        found = residual_change(change(rng, {2: 0.6}))
        left.append(found.residual)
        opening.append(found.opening[2])
        assert found.healthy > found.residual[2]
    mean = np.mean(left, axis=0)
    assert mean[2] < ELEMENTS < 3 * ELEMENTS < np.delete(mean, 2).min()
    assert np.mean(opening) == pytest.approx(0.6, abs=0.01)


def test_a_sound_arm_is_a_sound_arm_however_thin_the_errors() -> None:
    rng = np.random.default_rng(2)
    for thin in (1e-2, 1e-6):  # errors of second order are a share of the motion
        error = 0.5 * MODEL_SHARE
        found = [residual_change(change(rng, {}, thin=thin, error=error)) for _ in range(200)]
        assert np.mean([each.healthy for each in found]) < ELEMENTS
    far = [residual_change(change(rng, {}, error=0.15)) for _ in range(50)]
    assert min(each.healthy for each in far) > 3 * ELEMENTS
