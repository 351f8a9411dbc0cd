"""Confidence intervals of directions: they hold as often as they say."""

import math

import numpy as np
import pytest

from loose_env.errors import InvalidData, InvalidSetting, UnknownName
from loose_env.statistics import (
    DirectionInterval,
    axial_angle,
    axial_difference,
    bandpass,
    change_direction_interval,
    direction_interval,
    lowest_correlation_direction,
    transmission,
    transmission_by_instrument,
    transmission_change,
)

RATE = 1000.0
REPETITIONS = 300


def unit(angle):
    return np.array([math.cos(angle), math.sin(angle)])


def noise(rng, rows, count=1200):
    """Noise of 30 to 150 Hz, cut out of a longer record so that its ends do not meet."""
    signals = bandpass(rng.standard_normal((rows, 2 * count)), RATE, (30.0, 150.0))[:, :count]
    return signals / signals.std(axis=1, keepdims=True)


def steady(rng, true):
    """Record whose lowest correlation lies at `true`, with steady noise."""
    x, *rest = noise(rng, 3)
    return x, np.outer(unit(true - math.pi / 2), x) + rest


def gap(rng, true):
    """The same, the rest growing with the excitation as the motion in a gap does."""
    x, *rest = noise(rng, 3)
    return x, np.outer(unit(true - math.pi / 2), x) + 0.3 * (0.2 + x**2) * rest


def covered(intervals, true):
    return float(np.mean([interval.contains(true) for interval in intervals]))


@pytest.mark.parametrize("method", ["block", "hac"])
@pytest.mark.parametrize("record", [steady, gap])
def test_the_direction_lies_in_its_interval_as_often_as_stated(rng, method, record):
    # At 179 degrees the interval reaches across the wrap.
    true = math.radians(179.0)
    found = [
        direction_interval(*record(rng, true), RATE, method=method, rng=rng, resamples=400)
        for _ in range(REPETITIONS)
    ]
    # 300 repetitions know a coverage of 0.95 to 0.013.
    assert 0.90 <= covered(found, true) <= 0.985
    assert covered(found, true + math.radians(25.0)) < 0.6


@pytest.mark.parametrize("method", ["block", "hac"])
def test_the_standard_deviation_is_the_scatter_of_the_estimate(rng, method):
    found = [
        direction_interval(*gap(rng, 1.0), RATE, method=method, rng=rng, resamples=200)
        for _ in range(REPETITIONS)
    ]
    scatter = np.std([axial_difference(interval.direction, 1.0) for interval in found])
    assert np.sqrt(np.mean([interval.sd**2 for interval in found])) == pytest.approx(
        scatter, rel=0.15
    )


@pytest.mark.parametrize("method", ["block", "hac"])
def test_a_lower_level_holds_less_often(rng, method):
    found = [
        direction_interval(*steady(rng, 0.5), RATE, 0.5, method=method, rng=rng, resamples=400)
        for _ in range(REPETITIONS)
    ]
    # 300 repetitions know a coverage of 0.5 to 0.029.
    assert 0.42 <= covered(found, 0.5) <= 0.58


REFERENCE = np.array([[0.8, 0.1], [0.3, -0.6]])


def loose(rng, slide, m, encoder):
    """Commands, measured joint and tool accelerations of an arm loose along angle `slide`.

    The slide takes some of every joint's motion, and has a motion of its own.
    """
    command = noise(rng, m)
    x = 2.0 * command
    seat = np.array([[-0.5, 0.4][:m]]) @ x + 0.5 * noise(rng, 1)
    a = REFERENCE[:, :m] @ x + np.outer(unit(slide), seat) + 0.1 * noise(rng, 2)
    return command, x + encoder * noise(rng, m), a


@pytest.mark.parametrize("method", ["block", "hac"])
@pytest.mark.parametrize(("m", "encoder"), [(1, 0.0), (2, 0.0), (1, 0.5), (2, 0.5)])
def test_the_slide_lies_in_the_interval_of_the_change(rng, method, m, encoder):
    slide = math.radians(2.0)
    found = []
    for _ in range(REPETITIONS):
        command, x, a = loose(rng, slide, m, encoder)
        found.append(
            change_direction_interval(
                x,
                a,
                RATE,
                REFERENCE[:, :m],
                command=command if encoder else None,
                method=method,
                rng=rng,
                resamples=300,
            )
        )
    assert 0.90 <= covered(found, slide) <= 0.985
    half_widths = [0.5 * (interval.upper - interval.lower) for interval in found]
    assert np.median(half_widths) < math.radians(15.0)


def test_the_estimates_are_those_of_the_direction_functions(rng):
    x, a = steady(rng, 0.4)
    for method in ("block", "hac"):
        found = direction_interval(x, a, RATE, method=method, rng=rng)
        assert found.direction == pytest.approx(lowest_correlation_direction(x, a))
        assert found.lower < found.direction < found.upper
    command, x, a = loose(rng, 0.7, 2, 0.5)
    for given, b in (
        (None, transmission(x, a)),
        (command, transmission_by_instrument(command, x, a)),
    ):
        found = change_direction_interval(x, a, RATE, REFERENCE, command=given, method="hac")
        expected = axial_angle(transmission_change(b, REFERENCE).direction)
        assert axial_difference(found.direction, expected) == pytest.approx(0, abs=1e-12)


def test_one_draws_from_the_generator_and_the_other_does_not(rng):
    x, a = steady(rng, 0.4)
    first = direction_interval(x, a, RATE, rng=np.random.default_rng(1))
    again = direction_interval(x, a, RATE, rng=np.random.default_rng(1))
    other = direction_interval(x, a, RATE, rng=np.random.default_rng(2))
    assert first == again != other
    assert direction_interval(x, a, RATE, method="hac") == direction_interval(
        x, a, RATE, method="hac", rng=rng
    )


def test_a_record_that_says_nothing_gets_nearly_every_axis(rng):
    x, a = rng.standard_normal(400), rng.standard_normal((2, 400))
    a -= np.outer(a @ x / (x @ x) * (1 - 1e-3), x)
    for method in ("block", "hac"):
        found = direction_interval(x, a, RATE, method=method, rng=rng)
        assert math.radians(150) < found.upper - found.lower <= math.pi + 1e-12


def test_a_block_as_long_as_the_memory_widens_the_interval_of_one_sample(rng):
    # A block of one sample forgets that neighbours are alike; the memory is added back.
    x, a = steady(rng, 0.4)
    default = direction_interval(x, a, RATE, rng=rng, resamples=4000)
    short = direction_interval(x, a, RATE, rng=rng, resamples=4000, block=1 / RATE)
    assert short.sd == pytest.approx(default.sd, rel=0.15)


@pytest.mark.parametrize(
    ("angle", "inside"), [(3.0, True), (3.3, True), (0.1, True), (0.3, False), (2.8, False)]
)
def test_an_interval_reaches_across_the_wrap(angle, inside):
    interval = DirectionInterval(direction=3.1, lower=2.9, upper=3.35, sd=0.1, level=0.95)
    assert interval.contains(angle) is inside
    assert interval.contains(angle + math.pi) is inside


def test_an_interval_up_to_the_perpendicular_holds_it():
    whole = DirectionInterval(1.0, 1.0, 1.0 + math.pi / 2, 0.5, 0.95)
    assert whole.contains(1.0 + math.pi / 2)
    assert not whole.contains(0.9)


@pytest.mark.parametrize(
    ("options", "error", "said"),
    [
        ({"level": 1.0}, InvalidSetting, "level"),
        ({"level": 0.0}, InvalidSetting, "level"),
        ({"method": "jackknife"}, UnknownName, "'jackknife'.*'block', 'hac'"),
        ({"rng": None}, InvalidSetting, "rng"),
        ({"resamples": 1}, InvalidSetting, "resamples"),
        ({"block": 0.0}, InvalidSetting, "block"),
        ({"block": 2.0}, InvalidSetting, "1200 samples"),
        ({"rate": 0.0}, InvalidData, "rate"),
    ],
)
def test_settings_out_of_range_are_refused(rng, options, error, said):
    x, a = steady(rng, 0.4)
    settings = {"rate": RATE, "rng": rng} | options
    with pytest.raises(error, match=said):
        direction_interval(x, a, **settings)
    with pytest.raises(error, match=said):
        change_direction_interval(x, a, reference=[[1.0], [0.2]], **settings)


def test_records_without_a_direction_are_refused(rng):
    with pytest.raises(InvalidData, match="uncorrelated"):
        direction_interval(
            [1.0, -1.0, 1.0, -1.0], [[1.0, 1.0, -1.0, -1.0], [1.0, -1.0, -1.0, 1.0]], RATE, rng=rng
        )
    x, a = steady(rng, 0.4)
    with pytest.raises(InvalidData, match="alike in every direction, or not at all"):
        change_direction_interval(x, a, RATE, transmission(x, a), rng=rng)
    with pytest.raises(InvalidData, match=r"\(2, 2\)"):
        change_direction_interval(x, a, RATE, np.eye(2), rng=rng)


@pytest.mark.parametrize("encoder", [0.0, 0.3])
def test_both_methods_agree_when_the_change_has_two_directions(rng, encoder):
    # The error by hand and the error by resampling, where both singular values count.
    reference = REFERENCE + np.array([[0.2, 0.4], [-0.5, 0.6]])
    sds = {"block": [], "hac": []}
    for _ in range(20):
        command, x, a = loose(rng, 0.7, 2, encoder)
        for method, found in sds.items():
            interval = change_direction_interval(
                x, a, RATE, reference, command=command, method=method, rng=rng
            )
            found.append(interval.sd)
    assert np.mean(sds["hac"]) == pytest.approx(np.mean(sds["block"]), rel=0.1)


@pytest.mark.parametrize("method", ["block", "hac"])
def test_few_blocks_widen_the_interval_as_few_degrees_of_freedom_do(rng, method):
    # Blocks of 0.3 s in 1.2 s leave 6 degrees of freedom: 2.45 standard deviations, not 1.96.
    x, a = steady(rng, 0.4)
    found = direction_interval(x, a, RATE, method=method, rng=rng, resamples=4000, block=0.3)
    assert 0.5 * (found.upper - found.lower) / found.sd == pytest.approx(2.447, rel=0.1)
