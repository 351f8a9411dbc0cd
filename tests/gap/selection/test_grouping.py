"""Groups of one kind of effect at several places."""

from __future__ import annotations

from loose_env.gap.model.effects.catalogue import CATALOGUE
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.selection.screening.grouping import families, frictions, pairs
from loose_env.gap.selection.screening.screening import Screened
from tests.gap.cases.effect_arms import machine_of


def screened(
    machine: NominalModel, kind: str, where: str, promise: float, variant: str = ""
) -> Screened:
    effect = CATALOGUE[kind](machine, where, variant or None)
    return Screened(effect=effect, values=effect.starts[0], predicted=promise, z=5.0)


def test_the_kind_that_promises_most_together_comes_first() -> None:
    machine = machine_of("planar")
    found = families(
        [
            screened(machine, "link_mass", "link2", 0.5),
            screened(machine, "coulomb_friction", "joint1", 0.3),
            screened(machine, "coulomb_friction", "joint2", 0.3),
            screened(machine, "viscous_friction", "joint1", 0.2),
            screened(machine, "viscous_friction", "joint3", 0.1),
            screened(machine, "coulomb_friction", "joint3", 0.001),
        ],
        most=5,
    )
    kinds = [[(s.effect.kind, s.effect.where) for s in group] for group in found]
    assert kinds == [
        [("coulomb_friction", "joint1"), ("coulomb_friction", "joint2")],  # the third is idle
        [("viscous_friction", "joint1"), ("viscous_friction", "joint3")],
    ]


def test_of_every_kind_the_best_variant_counts() -> None:
    machine = machine_of("planar")
    found = families(
        [
            screened(machine, "actuator_gain", "servo1", 0.4, "command"),
            screened(machine, "actuator_gain", "servo2", 0.3),
            screened(machine, "actuator_gain", "servo3", 0.3),
            screened(machine, "actuator_gain", "servo3", 0.1, "command"),
        ],
        most=1,
    )
    assert [s.effect.variant for s in found[0]] == ["", ""]


def test_what_is_at_all_places_is_no_member_of_a_group() -> None:
    machine = machine_of("planar")
    late = [screened(machine, "command_delay", where, 0.3) for where in ("all", "servo1")]
    assert families(late, most=5) == []
    (group,) = families([*late, screened(machine, "command_delay", "servo3", 0.2)], most=5)
    assert [each.effect.where for each in group] == ["servo1", "servo3"]


def test_the_frictions_that_are_missing_at_a_joint_make_a_group() -> None:
    machine = machine_of("planar")
    oil = CATALOGUE["viscous_friction"](machine, "joint2")
    mass = CATALOGUE["link_mass"](machine, "link1")
    candidates = [
        screened(machine, "coulomb_friction", "joint1", 0.3),
        screened(machine, "coulomb_friction", "joint2", 0.1),
        screened(machine, "stribeck_friction", "joint2", 0.1),
        screened(machine, "quadratic_drag", "joint2", 0.05),
        screened(machine, "quadratic_drag", "joint1", 0.05),
    ]
    (group,) = frictions(candidates, [mass, oil])
    assert [(s.effect.kind, s.effect.where) for s in group] == [
        ("coulomb_friction", "joint2"),
        ("quadratic_drag", "joint2"),
    ]
    assert frictions(candidates, [mass]) == []
    assert frictions(candidates[:3], [oil]) == []  # a single one was tried by itself


def test_pairs_are_of_two_kinds_at_one_joint_the_most_promising_first() -> None:
    machine = machine_of("planar")
    found = pairs(
        [
            screened(machine, "load_friction", "joint1", 0.5),
            screened(machine, "load_friction", "joint1", 0.4, "stribeck"),
            screened(machine, "actuator_gain", "servo1", 0.3),
            screened(machine, "coulomb_friction", "joint2", 0.2),
            screened(machine, "backlash", "joint2", 0.01),
            screened(machine, "command_delay", "all", 0.9),
            screened(machine, "viscous_friction", "joint3", 0.1),
        ],
        most=5,
    )
    assert [[(s.effect.kind, s.effect.where) for s in pair] for pair in found] == [
        [("load_friction", "joint1"), ("actuator_gain", "servo1")],
        [("coulomb_friction", "joint2"), ("backlash", "joint2")],
    ]
