"""Intervals of a fit, and when an effect may be nothing at all."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from loose_env.gap.fitting.confidence_intervals import Intervals, bootstrap, widened
from loose_env.gap.fitting.gauss_newton import Fit
from loose_env.gap.fitting.model_structure import ModelStructure
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.effects.catalogue import CATALOGUE
from loose_env.gap.model.parameter import free_of
from tests.gap.cases.effect_arms import machine_of


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
        assert intervals.include_zero(effect, slice(0, 1)) is nothing


@pytest.mark.parametrize(
    ("kind", "where", "name", "end"),
    [
        ("joint_compliance", "joint2", "stiffness", "high"),
        ("link_flexibility", "link2", "stiffness", "high"),
        ("backlash", "joint2", "gap", "low"),  # without it the stops are a spring
        ("structural_looseness", "link2", "friction", "high"),
        ("stribeck_friction", "joint2", "torque", "low"),
    ],
)
def test_an_interval_that_reaches_the_limit_of_an_effect_includes_nothing(
    kind: str, where: str, name: str, end: str
) -> None:
    effect = CATALOGUE[kind](machine_of("planar"), where)
    parameters = effect.parameters
    number = [p.name for p in parameters].index(name)
    middle = np.array([np.sqrt(p.low * p.high) if p.log else 0.5 * (p.low + p.high)
                       for p in parameters])  # fmt: skip
    low, high = 0.9 * middle, 1.1 * middle
    assert not effect.interval_includes_null(low, high)
    if end == "high":
        high[number] = parameters[number].high
    else:
        low[number] = parameters[number].low
    assert effect.interval_includes_null(low, high)


def fit_of(effect: Effect, free: np.ndarray, residual: np.ndarray) -> Fit:
    """A fit of one effect whose number changes every reading alike."""
    return Fit(
        structure=ModelStructure(effects=(effect,)), free=free, residual=residual,
        jacobian=np.ones((len(residual), 1)), cost=0.0,
    )  # fmt: skip


def test_runs_that_disagree_widen_an_interval_and_never_to_nothing() -> None:
    machine = machine_of("planar")
    effect = CATALOGUE["coulomb_friction"](machine, "joint2")
    scale = effect.parameters[0].scale
    rng = np.random.default_rng(5)
    rows, runs = 300, 3
    residual = rng.normal(0.0, 0.1, rows) + np.repeat([-1.5, 0.0, 1.5], rows // runs)
    comparison = SimpleNamespace(
        rows=SimpleNamespace(trial=np.repeat(np.arange(runs), rows // runs))
    )
    fitted = fit_of(effect, np.array([1.0]), residual)
    narrow = Intervals(
        low=np.array([0.9 * scale]),
        high=np.array([1.1 * scale]),
        free=fitted.free,
        covariance=np.eye(1),
    )
    wide = widened(comparison, fitted, narrow)  # type: ignore[arg-type]
    assert wide.low[0] == narrow.low[0]
    assert wide.high[0] > 1.5 * narrow.high[0]
    # data without a contradiction are still no surer than the law itself
    sharp = replace(narrow, low=np.array([scale]), high=np.array([scale]))
    exact = replace(fitted, residual=np.zeros(rows))
    least = widened(comparison, exact, sharp)  # type: ignore[arg-type]
    assert (least.low[0], least.high[0]) == pytest.approx((0.995 * scale, 1.005 * scale))


@pytest.mark.parametrize(("first", "nothing"), [(0.0, True), (3.0, False)])
def test_what_the_data_do_not_answer_to_may_be_anything(first: float, nothing: bool) -> None:
    rng = np.random.default_rng(6)
    effect = CATALOGUE["link_com"](machine_of("planar"), "link2")
    count = len(effect.parameters)
    assert count == 2
    jacobian = np.stack([rng.normal(size=2000), np.zeros(2000)], axis=1)
    fitted = Fit(
        structure=ModelStructure(effects=(effect,)),
        free=np.array([first, 0.5]),  # nobody knows why the second one is not zero
        residual=rng.normal(size=2000),
        jacobian=jacobian,
        cost=0.0,
    )
    comparison = SimpleNamespace(rows=SimpleNamespace(block=np.repeat(np.arange(50), 40)))
    found = bootstrap(comparison, fitted, rng)
    assert (found.low[1], found.high[1]) == (effect.parameters[1].low, effect.parameters[1].high)
    assert found.high[0] - found.low[0] < 0.2 * effect.parameters[0].scale
    assert found.include_zero(effect, slice(0, 2)) is nothing
