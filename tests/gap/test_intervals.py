"""Intervals of a fit, and when an effect may be nothing at all."""

from __future__ import annotations

import numpy as np

from loose_env.gap.catalogue import CATALOGUE
from loose_env.gap.intervals import Intervals
from loose_env.gap.parameter import free_of
from tests.gap.effect_arms import machine_of


def around(draws: np.ndarray, kind: str, where: str) -> tuple[Intervals, object]:
    effect = CATALOGUE[kind](machine_of("planar"), where)
    free = draws / np.array([p.scale for p in effect.parameters])
    low, high = np.quantile(draws, (0.025, 0.975), axis=0)
    assert np.allclose(free_of(effect.parameters, np.zeros(len(low))), 0.0)
    spread = np.atleast_2d(np.cov(free, rowvar=False))
    return Intervals(low=low, high=high, free=free.mean(axis=0), covariance=spread), effect


def test_a_number_whose_interval_includes_nothing_may_be_nothing() -> None:
    rng = np.random.default_rng(3)
    for mean, nothing in ((0.5, True), (3.0, False)):
        draws = rng.normal(mean, 1.0, (2000, 1))
        intervals, effect = around(draws, "coulomb_friction", "joint2")
        assert intervals.may_be_nothing(effect, slice(0, 1)) is nothing


def test_parts_that_trade_against_each_other_are_judged_together() -> None:
    rng = np.random.default_rng(4)
    along = rng.normal(0.0, 0.05, 2000)  # neither part is known, their sum is
    size = len(CATALOGUE["link_com"](machine_of("planar"), "link2").parameters)
    assert size >= 2
    for sum_of_both, nothing in ((0.0, True), (0.02, False)):
        draws = rng.normal(0.0, 0.001, (2000, size))
        draws[:, 0] += along + 0.5 * sum_of_both
        draws[:, 1] += -along + 0.5 * sum_of_both
        intervals, effect = around(draws, "link_com", "link2")
        assert np.all((intervals.low < 0) & (intervals.high > 0))
        assert intervals.may_be_nothing(effect, slice(0, size)) is nothing
