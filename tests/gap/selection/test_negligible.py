"""What is too small to matter beside what was named before."""

from __future__ import annotations

import numpy as np
import pytest

from loose_env.gap.model.effect import Effect
from loose_env.gap.model.effects.catalogue import CATALOGUE
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.selection.negligible import negligible
from tests.gap.cases.effect_arms import machine_of

PLANAR = machine_of("planar")


def effect(kind: str, where: str) -> Effect:
    return CATALOGUE[kind](PLANAR, where)


def together(*parts: tuple[Effect, tuple[float, ...]]) -> Hypothesis:
    return Hypothesis(
        effects=tuple(e for e, _ in parts), values=tuple(np.array(v) for _, v in parts)
    )


@pytest.mark.parametrize(
    ("kind", "small", "large"),
    [
        ("coulomb_friction", (0.02,), (0.2,)),
        ("quadratic_drag", (0.02,), (0.2,)),
        ("stribeck_friction", (0.01, 1.6, 0.1), (0.1, 1.6, 0.1)),
    ],
)
def test_a_friction_within_the_law_of_another_at_its_joint_is_slight(
    kind: str, small: tuple[float, ...], large: tuple[float, ...]
) -> None:
    oil, other = effect("viscous_friction", "joint2"), effect(kind, "joint2")
    elsewhere = effect(kind, "joint3")
    assert negligible(together((oil, (1.0,)), (other, small)), 1)
    assert not negligible(together((oil, (1.0,)), (other, large)), 1)
    assert not negligible(together((oil, (1.0,)), (elsewhere, small)), 1)
    assert not negligible(together((other, small)), 1)
    # less friction than the model's counts by its size
    assert negligible(together((oil, (-1.0,)), (other, small)), 1)


def test_several_are_slight_if_all_of_them_are() -> None:
    oil, seal = effect("viscous_friction", "joint2"), effect("coulomb_friction", "joint2")
    drag = effect("quadratic_drag", "joint2")
    assert negligible(together((oil, (1.0,)), (seal, (0.01,)), (drag, (0.01,))), 2)
    assert not negligible(together((oil, (1.0,)), (seal, (0.01,)), (drag, (0.3,))), 2)


@pytest.mark.parametrize(
    ("kind", "where", "small", "large"),
    [
        ("payload", "tool", (0.1,), (0.5,)),
        ("link_mass", "link3", (-0.1,), (0.5,)),
        ("link_com", "link3", (0.01, 0.01), (0.05, 0.0)),
    ],
)
def test_a_mass_beside_a_link_that_bends_may_be_how_its_own_lies_along_it(
    kind: str, where: str, small: tuple[float, ...], large: tuple[float, ...]
) -> None:
    bends, mass = effect("link_flexibility", "link3"), effect(kind, where)
    values = (300.0, 0.05, 0.5)
    assert negligible(together((bends, values), (mass, small)), 1)
    assert not negligible(together((bends, values), (mass, large)), 1)
    assert not negligible(together((mass, small)), 1)
    spring = effect("joint_compliance", "joint3")
    assert not negligible(together((spring, (300.0, 0.05)), (mass, small)), 1)


def test_a_mass_two_links_away_from_one_that_bends_counts() -> None:
    bends, mass = effect("link_flexibility", "link3"), effect("link_mass", "link1")
    assert not negligible(together((bends, (300.0, 0.05, 0.5)), (mass, (0.05,))), 1)
