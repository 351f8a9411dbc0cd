"""How far seats can be driven open: friction and gravity hold them, level and pose open them."""

from __future__ import annotations

import dataclasses

import pytest

from loose_env.arms import LinearArm, planar
from loose_env.evaluation.hidden_faults import SeatOpenness
from loose_env.faults import Backlash, CompoundLooseness, Healthy, StructuralLooseness


def slide(direction, friction=5.0):
    return StructuralLooseness(
        link=2, direction=direction, gap=1e-4, stiffness=(1e4, 1e4), friction=friction
    )


def test_friction_and_level_count_as_they_should():
    openness = SeatOpenness(LinearArm(planar(3)))
    once = openness.ratio(slide((0, 1, 0)))
    assert openness.ratio(slide((0, 1, 0), 10.0)) == pytest.approx(once / 2)
    play = Backlash(joint=1, gap=1e-3, stiffness=(1e3, 1e3), friction=2.0)
    assert openness.ratio(play) > 0
    weak = planar(3)
    levels = tuple(level / 10 for level in weak.levels)
    gentle = SeatOpenness(LinearArm(dataclasses.replace(weak, levels=levels)))
    assert gentle.ratio(slide((0, 1, 0))) < 0.7 * once  # joint 1 is at its torque limit


def test_gravity_holds_a_seat_that_lies_along_it():
    lying, upright = (SeatOpenness(LinearArm(planar(3, vertical=v))) for v in (False, True))
    free = slide((0, 1, 0), 1e-6)
    assert lying.ratio(free) > 1e4
    assert upright.ratio(free) < 0.1 * lying.ratio(free)


def test_what_has_no_single_seat_has_no_ratio():
    openness = SeatOpenness(LinearArm(planar(2)))
    both = CompoundLooseness(link=2, parts=(slide((1, 0, 0)), slide((0, 1, 0))))
    assert openness.ratio(Healthy()) is None
    assert openness.ratio(both) is None
