"""Quadratures and differences have the order they claim; directions are those of the motion."""

import numpy as np
import pytest

from loose_env.errors import InvalidData
from loose_env.thesis.methods.motion.signals import (
    DIFFERENCES,
    QUADRATURES,
    differentiate,
    instantaneous_motion,
    integrate,
    line_of_motion,
    quadrature_steps,
    rms_motion,
    subtract_base,
)


def order_of(errors):
    """Power of the step from the errors at a step and at half of it."""
    return float(np.log2(errors[0] / errors[1]))


@pytest.mark.parametrize("rule", QUADRATURES)
def test_a_quadrature_is_exact_for_the_polynomials_it_is_made_for(rule):
    degree = len(QUADRATURES[rule].weights) - 1
    t = 2.0 + 0.25 * np.arange(12)
    for power in range(degree + 1):
        steps = quadrature_steps(t**power, 0.25, rule)
        ends = t[: len(steps)]
        exact = (ends ** (power + 1) - (ends - 0.25) ** (power + 1)) / (power + 1)
        np.testing.assert_allclose(steps, exact, rtol=1e-12)
    steps = quadrature_steps(t ** (degree + 1), 0.25, rule)
    exact = (t ** (degree + 2) - (t - 0.25) ** (degree + 2))[: len(steps)] / (degree + 2)
    assert np.abs(steps - exact).min() > 1e-4


@pytest.mark.parametrize("rule", QUADRATURES)
def test_the_error_of_a_quadrature_falls_with_the_order_it_states(rule):
    errors = []
    for dt in (0.02, 0.01):
        t = 1.0 + dt * np.arange(5)
        step = quadrature_steps(np.sin(t), dt, rule)[0]
        errors.append(abs(step - (np.cos(1.0 - dt) - np.cos(1.0))))
    assert order_of(errors) == pytest.approx(QUADRATURES[rule].order, abs=0.05)


@pytest.mark.parametrize("rule", DIFFERENCES)
def test_the_error_of_a_difference_falls_with_the_order_it_states(rule):
    errors = []
    for dt in (0.002, 0.001):
        t = 1.0 + dt * np.arange(5)
        errors.append(abs(differentiate(np.sin(t), dt, rule)[0] - np.cos(1.0)))
    assert order_of(errors) == pytest.approx(DIFFERENCES[rule].order, abs=0.05)


def test_noise_comes_through_as_each_rule_says():
    noise = np.random.default_rng(1).standard_normal((40, 5000))
    for rule, gain in (("two_point", np.sqrt(2.5)), ("newton_cotes", np.sqrt(7956) / 24)):
        assert QUADRATURES[rule].noise_gain == pytest.approx(gain)
        assert quadrature_steps(noise, 0.01, rule).std() == pytest.approx(0.01 * gain, rel=0.02)
    for rule, gain in (("two_point", np.sqrt(2)), ("three_point", np.sqrt(26) / 2)):
        assert DIFFERENCES[rule].noise_gain == pytest.approx(gain)
        assert differentiate(noise, 0.01, rule).std() == pytest.approx(100 * gain, rel=0.02)


def test_summed_quadratures_drift_alike_whatever_the_rule():
    noise = np.random.default_rng(2).standard_normal((3000, 400))
    ends = {rule: integrate(noise, 1e-4, rule)[:, -1] for rule in QUADRATURES}
    wanted = 1e-4 * np.sqrt(400)  # noise dt sqrt(count)
    for end in ends.values():
        assert end.std() == pytest.approx(wanted, rel=0.05)
    # They share every sample but those at the two ends.
    difference = ends["newton_cotes"] - ends["two_point"]
    assert difference.std() < 0.25 * wanted


def test_a_line_gives_its_own_direction_by_all_three_ways():
    motion = np.random.default_rng(3).standard_normal(2000)
    for degrees in (5.0, 30.0, 45.0, 80.0):
        angle = np.radians(degrees)
        x, y = np.cos(angle) * motion, np.sin(angle) * motion
        mean = rms_motion(x, y)
        assert np.degrees(mean.direction) == pytest.approx(degrees)
        assert mean.magnitude == pytest.approx(motion.std())
        np.testing.assert_allclose(np.degrees(instantaneous_motion(x, y).direction), degrees)
        fit = line_of_motion(x, y)
        assert np.degrees(fit.direction) == pytest.approx(degrees)
        assert fit.correlation == pytest.approx(1.0)


def test_noise_on_the_idle_axis_turns_the_rms_direction_as_the_arctangent_says():
    rng = np.random.default_rng(4)
    motion, noise = rng.standard_normal((2, 200_000))
    found = rms_motion(motion, 0.05 * noise)
    assert float(found.direction) == pytest.approx(np.arctan(0.05), rel=0.02)
    # The regression does not take it for motion.
    assert abs(line_of_motion(motion, 0.05 * noise).direction) < 0.001


def test_plain_subtraction_leaves_the_relative_motion():
    rng = np.random.default_rng(5)
    own, base = rng.standard_normal((2, 500))
    found = subtract_base(own + base, base)
    np.testing.assert_allclose(found.signal, own, atol=1e-12)
    assert float(found.gain) == 1.0


def test_a_fitted_gain_mends_the_gain_but_takes_correlated_motion_too():
    rng = np.random.default_rng(6)
    own, base = rng.standard_normal((2, 200_000))
    both = subtract_base([own + 0.9 * base, (own + 0.3 * base) + 0.9 * base], base, fit=True)
    np.testing.assert_allclose(both.gain, [0.9, 1.2], atol=0.01)


def test_bad_input_is_refused():
    with pytest.raises(InvalidData, match="direction"):
        rms_motion(np.ones(5), np.ones(5))
    with pytest.raises(InvalidData, match="does not vary"):
        line_of_motion(np.ones(5), np.arange(5))
    with pytest.raises(InvalidData, match="fit=False"):
        subtract_base(np.arange(5), np.ones(5), fit=True)
