"""p-values of episodes among those of the trained kind."""

from __future__ import annotations

import numpy as np
import pytest

from loose_env.diagnosis.novelty import CONTEXT, NoveltyReference, conformal_p, left_over
from loose_env.diagnosis.seat_features import PLACE_FEATURES, RECORD_FEATURES
from loose_env.errors import InvalidData
from loose_env.statistics.gaussian_mixture import fit_gaussian_mixture

SIZE = 1 + len(CONTEXT)


def made(rng: np.random.Generator, count: int) -> np.ndarray:
    """Figures of records whose left-over grows with their context."""
    context = rng.normal(size=(count, SIZE - 1))
    left = 2.0 * context[:, 0] - context[:, 3] + 0.5 * rng.normal(size=count)
    return np.column_stack([left, context])


@pytest.fixture(scope="module")
def reference() -> NoveltyReference:
    rng = np.random.default_rng(0)
    points = made(rng, 3000)
    mixture = fit_gaussian_mixture(points, 2, rng)
    first = NoveltyReference(
        mean=np.zeros(SIZE), scale=np.ones(SIZE), mixture=mixture, scores=(np.zeros(1),)
    )
    tables = tuple(
        np.sort([first.novelty(made(rng, k)).mean() for _ in range(999)]) for k in (1, 2)
    )
    return NoveltyReference(mean=first.mean, scale=first.scale, mixture=mixture, scores=tables)


@pytest.mark.parametrize("records", [1, 2])
def test_p_values_of_the_trained_kind_are_uniform(
    reference: NoveltyReference, records: int
) -> None:
    rng = np.random.default_rng(1)
    found = [reference.surprise(reference.novelty(made(rng, records))) for _ in range(2000)]
    for level in (0.02, 0.1, 0.5, 0.9):
        spread = 4 * np.sqrt(level * (1 - level) * (1 / 2000 + 1 / 1000))
        assert np.mean(np.array(found) <= level) == pytest.approx(level, abs=spread)


def test_what_is_left_is_judged_by_its_context(reference: NoveltyReference) -> None:
    rng = np.random.default_rng(2)
    usual = made(rng, 1)
    usual[0, 1], usual[0, 4] = 3.0, 0.0
    usual[0, 0] = 6.0  # large, and no more than such a context explains
    assert abs(reference.novelty(usual)[0]) < 1.0
    usual[0, 1] = 0.0
    assert reference.novelty(usual)[0] > 5.0
    assert reference.surprise(reference.novelty(usual)) == 1 / 1000


def test_the_last_table_serves_longer_episodes(reference: NoveltyReference) -> None:
    assert reference.surprise([1.0] * 7) == reference.surprise([1.0] * 2)
    assert reference.surprise([]) == 1.0


def test_it_is_stored_and_read_again(reference: NoveltyReference) -> None:
    again = NoveltyReference.of(reference.tensors())
    points = made(np.random.default_rng(3), 5)
    assert again.novelty(points) == pytest.approx(reference.novelty(points))
    assert again.surprise([0.4]) == reference.surprise([0.4])
    some = {k: v for k, v in reference.tensors().items() if k != "means"}
    with pytest.raises(InvalidData, match=r"lacks.*means"):
        NoveltyReference.of(some)
    with pytest.raises(InvalidData, match="another version"):
        NoveltyReference.of(reference.tensors() | {"mean": np.zeros(3)})


def test_conformal_p_counts_those_as_large() -> None:
    table = np.array([0.0, 1.0, 1.0, 2.0])
    assert [conformal_p(s, table) for s in (-1.0, 1.0, 1.5, 3.0)] == [1.0, 0.8, 0.4, 0.2]


def test_the_figures_follow_the_favoured_place() -> None:
    rng = np.random.default_rng(4)
    place = rng.uniform(0.1, 2.0, (3, 5, len(PLACE_FEATURES)))
    record = rng.normal(size=(3, len(RECORD_FEATURES)))
    found = left_over(place, record, np.eye(5)[2], 50.0)
    left = place[:, 2, PLACE_FEATURES.index("left")]
    assert found[:, 0] == pytest.approx(np.log(np.expm1(left) + 0.1))
    visible = place[:, 2, PLACE_FEATURES.index("visible")]
    assert found[:, 1 + CONTEXT.index("visible")] == pytest.approx(visible)
    excited = record[:, RECORD_FEATURES.index("excited")]
    assert found[:, 1 + CONTEXT.index("excited")] == pytest.approx(excited)
    assert found[0, 1 + CONTEXT.index("healthy")] == 10.0
    assert found[0, 1 + CONTEXT.index("records")] == pytest.approx(np.log(3))
