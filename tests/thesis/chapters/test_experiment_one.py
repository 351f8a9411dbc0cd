"""Strokes of the cylindrical arm: the boom goes over where its weight does, and only with play."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from loose_env.errors import InvalidSetting
from loose_env.thesis.ch6_experiments.arm.experiment_one import (
    repeatability,
    right_sets,
    ringing,
    shudder,
)
from loose_env.thesis.ch6_experiments.arm.guideway import (
    POSES,
    Guideway,
    StrokePose,
    shift_end,
    stroke_many,
    transfer_point,
)

QUIET = Guideway(potentiometer_noise=0.0, accelerometer_noise=0.0, trigger_jitter=0.0)


def stroke(name: str, settings: Guideway = QUIET, count: int = 1):
    return stroke_many(POSES[name], count, settings, np.random.default_rng(3))


def test_the_weight_is_over_the_guide_where_the_moments_of_the_parts_cancel():
    # Boom and flange, then each wrist link with its flange, about the front of the boom's frame.
    ahead = 0.55
    parts = [(110.0, ahead - 1.2), (5.0, 0.0)]
    for mass, length in ((16.0, 0.12), (11.0, 0.10), (8.0, 0.14)):
        parts += [(1.0, ahead), (mass, ahead + length / 2)]
        ahead += length
    total = sum(m for m, _ in parts)
    assert transfer_point() == pytest.approx(-sum(m * x for m, x in parts) / total)


def test_the_boom_stays_on_its_pair_of_blocks_until_the_weight_goes_over():
    found = stroke("B")
    seen = shudder(found, QUIET)
    assert seen is not None
    assert seen.leaves == pytest.approx(transfer_point(), abs=0.01)
    # It falls freely through the gap: the moment grows with the reach past the transfer point,
    # I a = m g v t, so the fall takes (6 gap I / (m g v))^(1/3), about 0.1 s.
    fall = (seen.lands - seen.leaves) / QUIET.speed
    assert 0.06 < fall < 0.16
    assert found.pitch[0, 0] == pytest.approx(-QUIET.gap / 2, abs=1.5e-4)
    assert found.pitch[0, -1] == pytest.approx(QUIET.gap / 2, abs=2e-4)


def test_no_shudder_where_the_weight_stays_or_without_play():
    assert shudder(stroke("A"), QUIET) is None
    tight = replace(QUIET, play=0.0)
    assert shudder(stroke("B", tight), tight) is None
    loose = stroke("B").acceleration[0]
    with_play, without = loose.std(), stroke("B", tight).acceleration[0].std()
    landed = slice(550, 750)
    assert loose[landed].std() > 5 * stroke("B", tight).acceleration[0][landed].std()
    assert with_play > without


def test_a_static_boom_sits_on_its_stop_by_its_weight_over_the_stiffness():
    found = stroke("B")
    moment = 153.0 * 9.81 * (transfer_point() - POSES["B"].start)
    sag = moment / QUIET.pitch_stiffness
    assert 0 < -found.pitch[0, 0] - QUIET.gap / 2 < 1.1 * sag


def test_without_noise_strokes_are_the_same_and_end_where_told():
    found = stroke("A", count=2)
    np.testing.assert_array_equal(found.acceleration[0], found.acceleration[1])
    moved = stroke_many(shift_end(POSES["A"], 0.004), 1, QUIET, np.random.default_rng(3))
    assert moved.reach[0, -1] - found.reach[0, -1] == pytest.approx(0.004, abs=2e-5)
    assert found.reach[0, -1] == pytest.approx(POSES["A"].end, abs=1e-3)


def test_noise_is_that_of_the_settings():
    found = stroke("A", Guideway(), count=8)
    noise = found.potentiometer - Guideway().potentiometer_scale * found.reach
    assert noise.std() == pytest.approx(25e-3 / 6, rel=0.03)
    again = stroke("A", Guideway(), count=8)
    np.testing.assert_array_equal(found.acceleration, again.acceleration)


def test_the_arm_raised_and_extended_rings_lower_than_anywhere_else():
    # The column's mode with locked joints is an input; guide and servo lower it, and less mass at
    # less height raises it, by an amount that nothing sets.
    raised = StrokePose(name="raised", swing=0.0, lift=0.76, start=0.55, end=1.05)
    low = StrokePose(name="low", swing=0.0, lift=0.0, start=0.55, end=1.05)
    found, lowered = ringing(Guideway(), raised), ringing(Guideway(), low)
    assert 7.2 < found < 8.0
    assert lowered > 1.1 * found


def test_measures_of_repeatability():
    rng = np.random.default_rng(1)
    wave = np.sin(np.arange(4000) / 20)
    strokes = wave + 0.1 * rng.standard_normal((40, 4000))
    found = repeatability(strokes)
    assert found.spread == pytest.approx(0.1 * np.sqrt(39 / 40), rel=0.01)
    # Correlation of a signal of power 1/2 with noise of 0.01, against a mean with a 39th of it.
    wanted = 0.5 / np.sqrt((0.5 + 0.01) * (0.5 + 0.01 / 39))
    assert found.lowest_correlation == pytest.approx(wanted, abs=0.002)
    alike = {k: rng.standard_normal((100, 50)) for k in "ab"}
    assert right_sets(alike) == pytest.approx(0.5, abs=0.12)
    alike["b"] = alike["b"] + 2.0
    assert right_sets(alike) == 1.0


def test_a_stroke_too_short_for_its_ramps_is_refused():
    with pytest.raises(InvalidSetting, match="too short"):
        stroke_many(shift_end(POSES["A"], -0.49), 1, QUIET, np.random.default_rng(0))
