"""Intervals of a fit, and when an effect may be nothing at all."""

from __future__ import annotations

import numpy as np
import pytest

from loose_env.gap.model.effects.catalogue import CATALOGUE
from tests.gap.cases.effect_arms import machine_of


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
