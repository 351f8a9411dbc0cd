"""Kinematics of the loose planar arm, and the assumed motion of its seat."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from loose_env.statistics import kurtosis
from loose_env.thesis.methods.motion.loose_planar_arm import (
    LoosePlanarArm,
    link_rate,
    looseness_direction,
    nominal_jacobian,
    tool_acceleration,
    tool_position,
    tool_velocity,
)
from loose_env.thesis.methods.motion.seat_motion import (
    DISTAL,
    FREE,
    PROXIMAL,
    MonteCarlo,
    SeatMotion,
    displacement_chain,
    draw_displacement,
    draw_seat_acceleration,
    draw_seat_velocity,
    draw_tool_acceleration,
    draw_tool_displacement,
    draw_tool_velocity,
    region_probabilities,
    regions,
    transition_table,
)

ARM = LoosePlanarArm(length1=0.5, length2=0.3, beta=0.7)
SPEED = np.array([[1.3], [-0.8]])


def motion(t):
    """Angles, slide and their first two derivatives along a smooth motion."""
    q, qd, qdd = np.sin(SPEED * t), SPEED * np.cos(SPEED * t), -(SPEED**2) * np.sin(SPEED * t)
    d, dd, ddd = 0.2 * np.sin(3 * t), 0.6 * np.cos(3 * t), -1.8 * np.sin(3 * t)
    return (q, qd, qdd), (d, dd, ddd)


def test_velocity_is_the_derivative_of_position():
    t, h = np.linspace(0.0, 2.0, 25), 1e-6
    (q, qd, _), (d, dd, _) = motion(t)
    ends = [tool_position(ARM, m[0][0], m[1][0]) for m in (motion(t - h), motion(t + h))]
    slope = (ends[1] - ends[0]) / (2 * h)
    np.testing.assert_allclose(tool_velocity(ARM, q, qd, d, dd), slope, atol=1e-8)


def test_acceleration_is_the_derivative_of_velocity_coriolis_included():
    t, h = np.linspace(0.0, 2.0, 25), 1e-6
    (q, qd, qdd), (d, dd, ddd) = motion(t)
    ends = []
    for at in (t - h, t + h):
        (a, ad, _), (s, sd, _) = motion(at)
        ends.append(tool_velocity(ARM, a, ad, s, sd))
    slope = (ends[1] - ends[0]) / (2 * h)
    np.testing.assert_allclose(tool_acceleration(ARM, q, qd, qdd, d, dd, ddd), slope, atol=1e-8)


def test_acceleration_as_printed():
    """Term by term, as equation 5.6 stands in print."""
    (q, qd, qdd), (d, dd, ddd) = motion(np.array([0.4]))
    c1, s1 = np.cos(q[0]), np.sin(q[0])
    c2, s2 = np.cos(q.sum(axis=0)), np.sin(q.sum(axis=0))
    cb, sb = np.cos(q.sum(axis=0) + ARM.beta), np.sin(q.sum(axis=0) + ARM.beta)
    w, a = qd.sum(axis=0), qdd.sum(axis=0)
    x = -0.5 * (qd[0] ** 2 * c1 + qdd[0] * s1) - d * (w**2 * cb + a * sb)
    x += -0.3 * (w**2 * c2 + a * s2) + ddd * cb - 2 * dd * w * sb
    y = 0.5 * (-(qd[0] ** 2) * s1 + qdd[0] * c1) + d * (-(w**2) * sb + a * cb)
    y += 0.3 * (-(w**2) * s2 + a * c2) + ddd * sb + 2 * dd * w * cb
    np.testing.assert_allclose(tool_acceleration(ARM, q, qd, qdd, d, dd, ddd), [x, y])


def test_tight_velocity_is_the_jacobian_times_the_rates():
    q, rate = np.array([0.3, 1.1]), np.array([0.7, -0.2])
    tight = tool_velocity(ARM, q, rate, 0.0, 0.0)
    np.testing.assert_allclose(nominal_jacobian(ARM, q) @ rate, tight)
    assert link_rate(rate) == pytest.approx(0.5)


def test_a_slide_adds_motion_along_its_own_direction_only():
    q = np.array([0.3, 1.1])
    moved = tool_position(ARM, q, 0.01) - tool_position(ARM, q, 0.0)
    np.testing.assert_allclose(moved, 0.01 * looseness_direction(ARM, q))
    np.testing.assert_allclose(looseness_direction(ARM, q), [math.cos(2.1), math.sin(2.1)])


@pytest.mark.parametrize(("proximal", "distal"), [(0.25, 0.25), (0.1, 0.4), (0.0, 0.0)])
def test_stops_hold_their_point_probabilities(proximal, distal):
    seat = SeatMotion(gap=2.0, at_proximal=proximal, at_distal=distal)
    d = draw_displacement(seat, 100_000, np.random.default_rng(1))
    where = regions(seat, d)
    assert np.mean(where == PROXIMAL) == pytest.approx(proximal, abs=0.006)
    assert np.mean(where == DISTAL) == pytest.approx(distal, abs=0.006)
    free = d[where == FREE]
    assert free.mean() == pytest.approx(0.0, abs=0.015)
    assert free.var() == pytest.approx(1 / 3, abs=0.01)  # Uniform between the stops.


def test_velocity_leaves_a_stop_and_crosses_the_gap_at_most():
    seat = SeatMotion(gap=1.0, timestep=0.5)
    d = np.repeat([-0.5, 0.0, 0.5], 20_000)
    v = draw_seat_velocity(seat, d, np.random.default_rng(2)).reshape(3, -1)
    assert v[0].min() == 0.0 and v[2].max() == 0.0
    assert np.abs(v).max() <= 2.0
    np.testing.assert_allclose(np.mean(v == 0.0, axis=1), [0.5, 0.0, 0.5], atol=0.015)
    np.testing.assert_allclose(v.mean(axis=1), [0.5, 0.0, -0.5], atol=0.03)
    assert v[1].var() == pytest.approx(4 / 3, abs=0.04)


def test_acceleration_never_leads_beyond_the_fastest_velocity():
    seat = SeatMotion(gap=1.0, timestep=0.5)
    rng = np.random.default_rng(3)
    d = draw_displacement(seat, 20_000, rng)
    v = draw_seat_velocity(seat, d, rng)
    a = draw_seat_acceleration(seat, d, v, rng)
    assert np.abs(v + a * seat.timestep).max() <= seat.fastest * (1 + 1e-12)
    assert a[d == -0.5].min() >= 0.0 and a[d == 0.5].max() <= 0.0


def test_acceleration_at_no_velocity_has_the_shape_of_the_velocity():
    seat = SeatMotion(gap=1.0, timestep=0.5)
    d = draw_displacement(seat, 1000, np.random.default_rng(4))
    v = draw_seat_velocity(seat, d, np.random.default_rng(5))
    a = draw_seat_acceleration(seat, d, np.zeros(1000), np.random.default_rng(5))
    np.testing.assert_allclose(a * seat.timestep, v)


def test_transition_table_of_the_assumed_motion():
    """From a stop: half stays. Between the stops: half stays, the rest splits between them."""
    seat = SeatMotion()
    chain = displacement_chain(seat, 100_000, np.random.default_rng(6))
    table = transition_table(regions(seat, chain))
    expected = np.array([[1, 1, 0], [1, 2, 1], [0, 1, 1]]) / 8
    np.testing.assert_allclose(table, expected, atol=0.006)
    np.testing.assert_allclose(region_probabilities(table), [0.25, 0.5, 0.25], atol=0.008)
    assert table.sum() == pytest.approx(1.0)


def test_longer_rest_holds_the_seat_longer():
    seat = SeatMotion(at_rest=0.8)
    chain = displacement_chain(seat, 100_000, np.random.default_rng(7))
    share = np.mean(regions(seat, chain) == PROXIMAL)
    assert share == pytest.approx(1 / (6 - 4 * 0.8), abs=0.01)


def test_tool_draws_are_gaussian_across_the_slide_and_not_along_it():
    setting = MonteCarlo(angle_sd=1e-4, rate_sd=0.1, acceleration_sd=100.0)
    slide = looseness_direction(setting.arm, setting.theta)
    across = [-slide[1], slide[0]]
    for draw in (draw_tool_displacement, draw_tool_velocity, draw_tool_acceleration):
        loose = draw(setting, 60_000, np.random.default_rng(8))
        tight = draw(replace(setting, seat=None), 60_000, np.random.default_rng(9))
        assert abs(kurtosis(loose, across)) < 0.08
        assert abs(kurtosis(tight, slide)) < 0.08
        assert abs(kurtosis(loose, slide)) > 0.2


def test_covariance_of_the_draws_is_that_of_the_jacobian_and_the_seat():
    setting = MonteCarlo()
    jacobian = nominal_jacobian(setting.arm, setting.theta)
    slide = looseness_direction(setting.arm, setting.theta)
    seat = setting.seat
    # Half the draws are uniform over the gap, the others lie at its ends.
    variance = seat.gap**2 * (0.5 / 12 + 0.5 / 4)
    expected = setting.angle_sd**2 * jacobian @ jacobian.T + variance * np.outer(slide, slide)
    drawn = np.cov(draw_tool_displacement(setting, 100_000, np.random.default_rng(10)))
    np.testing.assert_allclose(drawn, expected, atol=0.02 * np.abs(expected).max())
