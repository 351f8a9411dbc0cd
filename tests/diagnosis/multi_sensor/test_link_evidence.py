"""Sensors on links name the loose link in one pose; what cannot be seen is not claimed."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from scipy.special import logsumexp

from loose_env.arms import Arm, LinearArm, Mismatch, MismatchDraw, planar, scara, six_axis, vera
from loose_env.diagnosis.multi_sensor import link_evidence as several_sensors
from loose_env.diagnosis.multi_sensor.link_evidence import OpeningPrior, SensorVerdict, weigh_links
from loose_env.diagnosis.multi_sensor.sensed_arm import SensedArm
from loose_env.diagnosis.multi_sensor.sensor_rows import (
    SensorRows,
    StackedRecord,
    rows_of,
    splitting_order,
    stack,
)
from loose_env.errors import InvalidData, InvalidSetting
from loose_env.excitation import Excitation, at_levels
from loose_env.faults import Fault, Healthy, StructuralLooseness
from loose_env.rig import Job, SimulatedRig
from loose_env.sensors import LinkAccelerometers, SensorSuite
from loose_env.statistics import axial_angle_between
from loose_env.typing import Array

EVERY = LinkAccelerometers()
NONE = Mismatch().scaled(0.0)
POSE = np.array([0.4, 0.9, -0.7, 1.1])


def a_pose(arm: Arm) -> Array:
    return arm.random_pose(np.random.default_rng(3))


def simulated(
    arm: Arm,
    fault: Fault,
    *,
    pose: Array,
    seed: int = 0,
    draw: MismatchDraw | None = None,
    sensors: SensorSuite | None = None,
    level: int = 1,
    duration: float = 0.6,
) -> list[StackedRecord]:
    """Records of all sensors, every joint excited in turn."""
    suite = dataclasses.replace(sensors or SensorSuite(), link_accelerometers=EVERY)
    rig, linear = SimulatedRig(arm, sensors=suite), LinearArm(arm)
    rig.mount(0, fault, draw)
    records = []
    for joint in range(arm.n):
        levels = np.zeros(arm.n)
        levels[joint] = arm.levels[level]
        shake, _ = at_levels(linear.at(pose), levels, duration=duration)
        rng = np.random.default_rng([seed, joint])
        found = rig.measure_many([Job(slot=0, pose=pose, excitation=shake, rng=rng)])[0]
        records.append(stack(found, rows_of(arm, EVERY)))
    return records


def projected(records: Sequence[StackedRecord], matrix: Array) -> list[StackedRecord]:
    return [r.projected(matrix) for r in records]


@pytest.mark.parametrize(
    ("make", "tolerance"), [(lambda: planar(3), 0.02), (six_axis, 0.02), (scara, 0.02), (vera, 0.1)]
)
def test_a_healthy_arm_moves_every_sensor_as_predicted(
    make: Callable[[], Arm], tolerance: float
) -> None:
    # The bending mode of VERA lies in the band: the average over it depends on the draw.
    arm = make()
    pose, rows = a_pose(arm), rows_of(arm, EVERY)
    sensed = SensedArm(arm, links=EVERY.on(arm))
    for record in simulated(arm, Healthy(), pose=pose, sensors=SensorSuite.ideal()):
        at = sensed.at(pose, record.excited)
        sites = np.searchsorted([0, *sensed.links], rows.link)
        expected = np.einsum("dc,dcm->dm", rows.direction, at.transmission[sites])
        size = np.abs(expected).max()
        np.testing.assert_allclose(record.transmission, expected, atol=tolerance * size)


@pytest.mark.parametrize(
    ("make", "most"), [(lambda: planar(4), 0.1), (six_axis, 0.1), (scara, 0.1), (vera, 0.5)]
)
def test_a_seat_shows_beyond_it_alone(make: Callable[[], Arm], most: float) -> None:
    arm = make()
    sensed = SensedArm(arm, links=EVERY.on(arm))
    at = sensed.at(a_pose(arm), np.arange(arm.n) == 0)
    size = np.linalg.norm(at.column, axis=(1, 3))  # (sensors, links)
    for link in range(1, arm.n + 1):
        before = [size[k, link - 1] for k in range(1, link)]
        beyond = [size[k, link - 1] for k in (0, *range(link, arm.n + 1))]
        # Brakes give a little; VERA's link 1 bends under what its link 2 does.
        assert max(before, default=0.0) < most * min(beyond)


def _brute_force(
    change: Array, scatter: Array, modes: Array, basis: Array, u: Array, mass: Array
) -> float:
    """Log-likelihood of one link's direction by the whole covariance of everything."""
    columns, d = change.shape
    opening = OpeningPrior()
    noise = np.zeros((columns * d, columns * d))
    for e in range(columns):
        noise[e * d : (e + 1) * d, e * d : (e + 1) * d] = scatter[e]
    flat = modes.reshape(len(modes), -1)
    noise += flat.T @ flat
    product = np.outer(u, u).ravel() / (u @ mass @ u)
    opened = np.zeros((columns, columns * d))
    aside = np.zeros((columns, columns * d))
    for e in range(columns):
        opened[e, e * d : (e + 1) * d] = basis[e][:, : len(product)] @ product
        aside[e, e * d : (e + 1) * d] = basis[e][:, len(product) :] @ u
    prior = opening.shared**2 + opening.own**2 * np.eye(columns)
    loose = opened.T @ prior @ opened + aside.T @ aside
    y = change.ravel()

    def log(covariance: Array) -> float:
        fit = y @ np.linalg.solve(covariance, y)
        return float(-0.5 * (fit + np.linalg.slogdet(covariance)[1]))

    ratios = [log(noise + size**2 * loose) - log(noise) for size in opening.sizes]
    return float(np.log(np.mean(np.exp(ratios))))


@pytest.mark.parametrize("axes", [2, 3])
def test_the_likelihood_is_that_of_the_whole_covariance(axes: int) -> None:
    rng = np.random.default_rng(1)
    columns, d, n, q = 3, 5, 2, axes**2 + axes
    change = rng.standard_normal((columns, d))
    root = rng.standard_normal((columns, d, d))
    scatter = root @ root.transpose(0, 2, 1) + 0.1 * np.eye(d)
    modes = 0.5 * rng.standard_normal((4, columns, d))
    basis = rng.standard_normal((columns, n, d, q))
    mass = np.array([np.diag(rng.uniform(1, 2, axes)) for _ in range(n)])
    whole = several_sensors._Weighed(change, scatter, modes, basis)
    likelihood = several_sensors._Likelihood(whole, mass, OpeningPrior())
    u = rng.standard_normal((n, 4, axes))
    u /= np.linalg.norm(u, axis=-1, keepdims=True)
    found = likelihood(u)
    for k in range(n):
        for i in range(4):
            expected = _brute_force(change, scatter, modes, basis[:, k], u[k, i], mass[k])
            assert found[k, i] == pytest.approx(expected, rel=1e-9)


def synthetic(
    sensed: SensedArm,
    rows: SensorRows,
    rng: np.random.Generator,
    *,
    link: int,
    direction: Array | None,
    noise: float,
) -> tuple[list[StackedRecord], list[StackedRecord]]:
    """Records and reference whose change is the model's own, with white noise."""
    arm = sensed.arm
    pose, axes = a_pose(arm), len(arm.axes)
    sites = np.searchsorted([0, *sensed.links], rows.link)
    found: tuple[list[StackedRecord], list[StackedRecord]] = ([], [])
    for joint in range(arm.n):
        excited = np.arange(arm.n) == joint
        at = sensed.at(pose, excited)
        healthy = np.einsum("dc,dcm->dm", rows.direction, at.transmission[sites])
        change = np.zeros_like(healthy)
        if direction is not None:
            u = direction[:axes]
            driven = np.einsum(
                "dc,dcabm,a,b->dm", rows.direction, at.driven[sites, :, link - 1], u, u
            )
            change = 0.6 * driven / (u @ at.mass[link - 1] @ u)
        for records, b in zip(found, (healthy + change, healthy), strict=True):
            records.append(
                StackedRecord(
                    pose=pose,
                    torque=excited * 1.0,
                    joint=np.eye(1),
                    transmission=b + noise * rng.standard_normal(b.shape),
                    rest=100 * noise**2 * np.eye(len(rows)),
                    samples=np.full(len(rows), 100.0),
                )
            )
    return found


@pytest.mark.parametrize("make", [lambda: planar(3), six_axis])
def test_directions_scatter_as_stated(make: Callable[[], Arm]) -> None:
    arm = make()
    sensed = SensedArm(arm, links=(2,))
    rows = rows_of(arm, LinkAccelerometers(links=(2,)))
    rng = np.random.default_rng(0)
    ratios = []
    for _ in range(60):
        u = np.zeros(3)
        u[: len(arm.axes)] = rng.standard_normal(len(arm.axes))
        u /= np.linalg.norm(u)
        now, before = synthetic(sensed, rows, rng, link=2, direction=u, noise=2e-3)
        verdict = weigh_links(sensed, rows, now, before, mismatch=NONE)
        error = np.arccos(min(abs(float(verdict.direction[1] @ u)), 1.0))
        if verdict.spread[1] < 0.2:
            ratios.append(error / verdict.spread[1])
    assert len(ratios) > 30
    # The unmodelled share of a change that is allowed for is not in these data, so the spread may
    # be too wide but not too narrow.
    assert 0.4 < np.sqrt(np.mean(np.square(ratios))) < 1.3


def mismatched(
    arm: Arm, cases: int
) -> list[tuple[StructuralLooseness, list[StackedRecord], list[StackedRecord]]]:
    """Faults in arms unlike the nominal one, each in a pose of its own, with their references."""
    rng = np.random.default_rng(5)
    linear, rows = LinearArm(arm), rows_of(arm, EVERY)
    rig = SimulatedRig(arm, slots=cases, sensors=SensorSuite(link_accelerometers=EVERY))
    faults, poses, draws = [], [], []
    for k in range(cases):
        u = np.zeros(3)
        u[: len(arm.axes)] = rng.standard_normal(len(arm.axes))
        faults.append(loose(1 + k % arm.n, tuple(u / np.linalg.norm(u))))
        poses.append(arm.random_pose(rng))
        draws.append(Mismatch().draw(arm, rng))
    found: list[list[list[StackedRecord]]] = []
    for shut in (False, True):
        for k, fault in enumerate(faults):
            rig.mount(k, Healthy() if shut else fault, draws[k])
        records: list[list[StackedRecord]] = [[] for _ in faults]
        for joint in range(arm.n):
            levels = np.where(np.arange(arm.n) == joint, arm.levels[-1], 0.0)
            jobs = [
                Job(
                    slot=k,
                    pose=pose,
                    excitation=at_levels(linear.at(pose), levels, duration=0.4)[0],
                    rng=np.random.default_rng([shut, joint, k]),
                )
                for k, pose in enumerate(poses)
            ]
            for k, measurement in enumerate(rig.measure_many(jobs)):
                records[k].append(stack(measurement, rows))
        found.append(records)
    return list(zip(faults, *found, strict=True))


def test_two_standard_deviations_hold_the_true_direction() -> None:
    # Gains, leakage and mounting of the sensors and the joints' zeros are the same in all records.
    arm = planar(4)
    cases, full = mismatched(arm, 16), rows_of(arm, EVERY)
    sensed = SensedArm(arm, links=EVERY.on(arm), mismatch=Mismatch())
    for links in (None, LinkAccelerometers(links=(2,)), EVERY, LinkAccelerometers(tangential=True)):
        rows = rows_of(arm, links)
        matrix = full.projection(rows)
        ratios, surprise = [], []
        for fault, *records in cases:
            now, before = (projected(part, matrix) for part in records)
            for reference in (before, None):
                verdict = weigh_links(sensed, rows, now, reference)
                k = fault.link - 1
                error = axial_angle_between(verdict.direction[k], fault.direction)
                ratios.append(error / verdict.spread[k])
                surprise.append(logsumexp(verdict.evidence) - verdict.evidence[k])
        assert np.mean(np.array(ratios) <= 2.0) >= 0.86
        assert np.sqrt(np.mean(np.square(ratios))) > 0.3  # not by being far too wide
        # Better than knowing nothing of the link, which a few overconfident errors would undo.
        assert np.mean(surprise) < np.log(arm.n)


def test_more_records_do_not_average_out_what_all_records_share(
    four_links: dict[int, tuple[list[StackedRecord], list[StackedRecord]]],
) -> None:
    now, before = four_links[2]
    once = verdict_of((now, before), EVERY)
    often = verdict_of((now * 4, before * 4), EVERY)
    assert often.spread[1] > 0.7 * once.spread[1]
    exact = verdict_of((now, before), EVERY, mismatch=NONE)
    assert exact.spread[1] < 0.7 * once.spread[1]


def test_noise_alone_speaks_for_the_healthy_arm() -> None:
    arm = planar(3)
    sensed, rows = SensedArm(arm, links=(1, 2, 3)), rows_of(arm, EVERY)
    rng = np.random.default_rng(0)
    odds = []
    for _ in range(40):
        now, before = synthetic(sensed, rows, rng, link=1, direction=None, noise=1e-3)
        odds.append(weigh_links(sensed, rows, now, before).odds)
    assert np.mean(np.array(odds) < 0) > 0.9


def loose(link: int, direction: tuple[float, float, float]) -> StructuralLooseness:
    return StructuralLooseness(
        link=link,
        direction=direction,
        gap=1e-4,
        stiffness=(4e5, 4e5),
        damping=(30.0, 30.0),
        friction=0.05,
    )


@pytest.fixture(scope="module")
def four_links() -> dict[int, tuple[list[StackedRecord], list[StackedRecord]]]:
    """Records of a planar arm with each link loose, with the healthy arm's as reference."""
    arm = planar(4)
    found = {}
    for link in range(1, 5):
        draw = Mismatch().draw(arm, np.random.default_rng(link))
        found[link] = tuple(
            simulated(arm, fault, pose=POSE, seed=seed, draw=draw)
            for seed, fault in ((1, loose(link, (0.6, 0.8, 0.0))), (2, Healthy()))
        )
    return found  # type: ignore[return-value]


def verdict_of(
    records: tuple[list[StackedRecord], list[StackedRecord]],
    links: LinkAccelerometers | None,
    *,
    tool: bool = True,
    nominal: bool = False,
    mismatch: Mismatch | None = None,
) -> SensorVerdict:
    arm = planar(4)
    sensed, rows = SensedArm(arm, links=EVERY.on(arm)), rows_of(arm, links, tool=tool)
    matrix = rows_of(arm, EVERY).projection(rows)
    now, before = (projected(part, matrix) for part in records)
    return weigh_links(sensed, rows, now, None if nominal else before, mismatch=mismatch)


@pytest.mark.parametrize("link", [1, 2, 3, 4])
@pytest.mark.parametrize("tangential", [False, True])
@pytest.mark.parametrize("nominal", [False, True])
def test_one_pose_names_the_link_and_its_direction(
    four_links: dict[int, tuple[list[StackedRecord], list[StackedRecord]]],
    link: int,
    tangential: bool,
    nominal: bool,
) -> None:
    links = LinkAccelerometers(tangential=tangential)
    verdict = verdict_of(four_links[link], links, nominal=nominal)
    assert verdict.link == link
    assert verdict.probabilities()[link] > 0.99
    error = np.degrees(np.arccos(abs(float(verdict.direction[link - 1] @ [0.6, 0.8, 0.0]))))
    assert error < (8 if tangential else 5)


def test_a_seat_beyond_all_sensors_is_not_claimed(
    four_links: dict[int, tuple[list[StackedRecord], list[StackedRecord]]],
) -> None:
    first = LinkAccelerometers(links=(1,))
    blind = verdict_of(four_links[4], first, tool=False)
    assert blind.odds < verdict_of(four_links[4], None).odds - 100


def test_the_healthy_arm_against_its_own_records_is_called_healthy() -> None:
    arm = planar(4)
    draw = Mismatch().draw(arm, np.random.default_rng(9))
    now, before = (simulated(arm, Healthy(), pose=POSE, seed=s, draw=draw) for s in (1, 2))
    verdict = verdict_of((now, before), EVERY)
    assert verdict.probabilities()[0] > 0.9
    assert verdict.probabilities().sum() == pytest.approx(1.0)


def test_links_get_sensors_where_they_split_most() -> None:
    for n in range(1, 8):
        order = splitting_order(n)
        assert sorted(order) == list(range(1, n + 1))
        assert order[-1] == n  # beside the tool it splits nothing
    assert splitting_order(4)[0] == 2


def test_rows_make_the_readings_of_fewer_sensors() -> None:
    arm = planar(3)
    full = rows_of(arm, EVERY)
    part = rows_of(arm, LinkAccelerometers(links=(2,), tangential=True))
    matrix = full.projection(part)
    readings = np.arange(8.0)
    np.testing.assert_allclose(matrix @ readings, [0.0, 1.0, 5.0])
    with pytest.raises(InvalidSetting, match="do not measure"):
        part.projection(full)
    with pytest.raises(InvalidSetting, match="no accelerometer is left"):
        rows_of(arm, None, tool=False)


def test_records_that_do_not_fit_are_refused(
    four_links: dict[int, tuple[list[StackedRecord], list[StackedRecord]]],
) -> None:
    arm = planar(4)
    now, before = four_links[1]
    sensed, rows = SensedArm(arm, links=EVERY.on(arm)), rows_of(arm, EVERY)
    with pytest.raises(InvalidData, match="at least one record"):
        weigh_links(sensed, rows, [])
    with pytest.raises(InvalidData, match="need as many references, got 3"):
        weigh_links(sensed, rows, now, before[:3])
    with pytest.raises(InvalidData, match="record 0 and its reference differ"):
        weigh_links(sensed, rows, now, before[::-1])
    with pytest.raises(InvalidData, match=r"sensors on links \[1, 2, 3, 4\]"):
        weigh_links(SensedArm(arm, links=()), rows, now)
    moved = dataclasses.replace(now[1], pose=POSE + 0.1)
    with pytest.raises(InvalidData, match="one pose"):
        weigh_links(sensed, rows, [now[0], moved])


def test_a_record_with_other_channels_is_refused() -> None:
    arm = planar(2)
    shake = Excitation(torque_rms=(3.0, 0.0), duration=0.2, band=(30.0, 150.0))
    found = SimulatedRig(arm).measure(np.array([0.1, 0.4]), shake)
    with pytest.raises(InvalidData, match="has 2 axes of accelerometers, the rows describe 6"):
        stack(found, rows_of(arm, EVERY))
    with pytest.raises(InvalidData, match="worthless"):
        stack(dataclasses.replace(found, failure="it fell over"), rows_of(arm, None))
