"""The search for the loose link on records of simulated arms."""

from __future__ import annotations

import numpy as np
import pytest

from loose_env.arms import planar
from loose_env.diagnosis import Order
from loose_env.thesis.ch4_diagnosis.link_finding import ESTIMATORS, search

ARMS = 24


@pytest.mark.parametrize(("order", "most"), [("outward", 2), ("inward", 2), ("bisection", 2)])
def test_the_change_of_transmission_finds_most_links(order: Order, most: int) -> None:
    runs = search(planar(3), ESTIMATORS["change of transmission"], order, seed=3, arms=ARMS)
    assert [r.link for r in runs] == [1 + k % 3 for k in range(ARMS)]
    assert all(1 <= r.moves <= most for r in runs)
    # A blind guess names a third; half and more is beyond chance at 24 arms.
    assert np.mean([r.named == r.link for r in runs]) > 0.55


def test_going_outward_a_right_search_takes_as_many_moves_as_the_link_says() -> None:
    runs = search(planar(3), ESTIMATORS["change of transmission"], "outward", seed=3, arms=ARMS)
    for run in runs:
        if run.named == run.link:
            assert run.moves == min(run.link, 2)


def test_the_same_seed_gives_the_same_searches() -> None:
    one, other = (
        search(planar(3), ESTIMATORS["lowest correlation"], "inward", seed=4, arms=6)
        for _ in range(2)
    )
    assert one == other
