"""The posterior over faults: what it must do whatever its accuracy, and a floor under that."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from loose_env.arms import Arm, LinearArm, Mismatch, planar, scara, six_axis, vera
from loose_env.diagnosis import (
    OPENINGS,
    PRESSES,
    Belief,
    FaultPosterior,
    PosteriorSettings,
    RecordStatistics,
    shipped_table,
    statistics_of,
)
from loose_env.envs import Difficulty, FaultSampler
from loose_env.errors import InvalidSetting
from loose_env.excitation import at_levels
from loose_env.faults import Fault, Healthy, StructuralLooseness, hypotheses, place_of
from loose_env.rig import SimulatedRig
from loose_env.sensors import SensorSuite


def played(
    arm: Arm,
    faults: list[Fault],
    count: int,
    seed: int,
    *,
    sensors: SensorSuite | None = None,
    mismatch: bool = True,
    joints: int | None = None,
) -> list[list[RecordStatistics]]:
    """Records of each arm in random poses, the first joints in turn at the top level."""
    rng = np.random.default_rng(seed)
    rig = SimulatedRig(arm, slots=len(faults), sensors=sensors)
    for slot, fault in enumerate(faults):
        rig.mount(slot, fault, Difficulty().mismatch.draw(arm, rng) if mismatch else None)
    found: list[list[RecordStatistics]] = [[] for _ in faults]
    for k in range(count):
        trials = []
        for slot in range(len(faults)):
            pose, levels = arm.random_pose(rng), np.zeros(arm.n)
            levels[(slot + k) % (joints or arm.n)] = arm.levels[-1]
            excitation, _ = at_levels(rig.nominal.at(pose), levels, duration=1.2)
            trials.append((slot, pose, excitation, rng.spawn(1)[0]))
        for slot, measurement in enumerate(rig.measure_all(*zip(*trials, strict=True))):
            found[slot].append(statistics_of(measurement))
    return found


def after(posterior: FaultPosterior, records: list[RecordStatistics]) -> Belief:
    belief = posterior.start()
    for record in records:
        belief = posterior.update(belief, record)
    return belief


@pytest.fixture(scope="module")
def planar3() -> FaultPosterior:
    return FaultPosterior(LinearArm(planar(3)), SensorSuite())


@pytest.fixture(scope="module")
def drawn() -> tuple[list[Fault], list[list[RecordStatistics]]]:
    arm = planar(3)
    sampler = FaultSampler(LinearArm(arm), Difficulty())
    rng = np.random.default_rng(21)
    faults = [sampler.draw(rng) for _ in range(40)]
    return faults, played(arm, faults, 3, seed=22, joints=1)


def scored(
    posterior: FaultPosterior, faults: list[Fault], records: list[list[RecordStatistics]]
) -> tuple[int, float]:
    """Right verdicts, and the mean log probability of the truth."""
    right, log = 0, []
    for fault, own in zip(faults, records, strict=True):
        p = after(posterior, own).probabilities
        assert p.sum() == pytest.approx(1.0)
        truth = posterior.hypotheses.index(fault.hypothesis)
        right += int(np.argmax(p) == truth)
        log.append(np.log(max(p[truth], 1e-12)))
    return right, float(np.mean(log))


def test_it_names_most_faults_after_three_records(
    planar3: FaultPosterior, drawn: tuple[list[Fault], list[list[RecordStatistics]]]
) -> None:
    right, log_score = scored(planar3, *drawn)
    assert right >= 32  # of 40; blind guessing is right on about 13
    assert log_score > -0.7  # knowing only the prior scores -1.55


def test_the_order_of_records_does_not_matter(
    planar3: FaultPosterior, drawn: tuple[list[Fault], list[list[RecordStatistics]]]
) -> None:
    first, second, third = drawn[1][0]
    there, back = planar3.start(), planar3.start()
    for a, b in zip((first, second, third), (third, first, second), strict=True):
        there, back = planar3.update(there, a), planar3.update(back, b)
    assert there.probabilities == pytest.approx(back.probabilities, abs=1e-9)


@pytest.mark.parametrize(
    "arm", [planar(3), pytest.param(vera(), marks=pytest.mark.slow)], ids=["planar3", "vera"]
)
def test_healthy_arms_are_called_healthy(arm: Arm) -> None:
    posterior = FaultPosterior(LinearArm(arm), SensorSuite())
    called = 0
    for records in played(arm, [Healthy()] * 16, 3, seed=5, joints=1):
        belief = after(posterior, records)
        called += int(np.argmax(belief.probabilities) == 0)
    assert called >= 12  # of 16


def test_a_seat_that_friction_keeps_shut_cannot_be_placed() -> None:
    arm = planar(3)
    stuck = (8.0, 12.0)
    sampler = FaultSampler(LinearArm(arm), Difficulty(friction=stuck))
    fault = sampler.draw(np.random.default_rng(1), hypothesis="structural_looseness@link2")
    (records,) = played(arm, [fault], 2, seed=3, joints=1)
    posterior = FaultPosterior(LinearArm(arm), SensorSuite(), PosteriorSettings(friction=stuck))
    belief = after(posterior, records)
    faulty = belief.probabilities[1:]
    assert faulty / faulty.sum() == pytest.approx(np.full(6, 1 / 6), abs=0.02)


def test_the_shipped_table_holds_distributions_that_open_as_the_drive_grows() -> None:
    table = shipped_table()
    for part in (table.slide, table.hinge):
        assert part.sum(axis=(2, 3)) == pytest.approx(np.ones(part.shape[:2]), abs=0.02)
        mean = np.einsum("hrsq,s->hr", part, OPENINGS)
        assert mean[:, :4] == pytest.approx(np.zeros((len(PRESSES), 4)))
        assert mean[0, 5:].max() > 0.15


@pytest.mark.parametrize(
    "wrong",
    [
        {"friction": (0.0, 1.0)},
        {"friction": (1.0, 0.5)},
        {"directions": 1},
        {"space_directions": 2},
        {"temper": 0.0},
        {"kinds": {"healthy": 0.5, "compound_looseness": 0.5}},
    ],
)
def test_settings_that_make_no_sense_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(InvalidSetting):
        PosteriorSettings(**wrong)  # type: ignore[arg-type]


def weightless(arm: Arm) -> Arm:
    spec = arm.spec.copy()
    spec.option.gravity = [0, 0, 0]
    return dataclasses.replace(arm, spec=spec)


@pytest.mark.parametrize("make", [six_axis, scara])
def test_a_healthy_arm_without_noise_is_called_healthy(make: Callable[[], Arm]) -> None:
    arm, ideal = make(), SensorSuite.ideal()
    posterior = FaultPosterior(LinearArm(arm), SensorSuite())
    belief = after(posterior, played(arm, [Healthy()], 6, seed=1, sensors=ideal, mismatch=False)[0])
    assert posterior.hypotheses[int(np.argmax(belief.probabilities))] == "healthy"
    assert belief.probabilities[0] > 0.6  # its prior was a third


@pytest.mark.parametrize("link", [3, 4])
def test_a_seat_that_floats_is_named_with_its_direction(link: int) -> None:
    arm = weightless(six_axis())
    direction = (0.48, -0.6, 0.64)
    # So wide that no stop is reached, and no friction.
    fault = StructuralLooseness(link=link, direction=direction, gap=0.05, stiffness=(1e4, 1e4))
    posterior = FaultPosterior(LinearArm(arm), SensorSuite())
    belief = posterior.start()
    # Joints beyond the seat say little about it.
    for record in played(arm, [fault], 6, seed=link, mismatch=False, joints=3)[0]:
        belief = posterior.update(belief, record)
    named = posterior.hypotheses[int(np.argmax(belief.probabilities))]
    assert named == f"structural_looseness@link{link}"
    angle = np.degrees(np.arccos(min(1.0, abs(belief.axis(link) @ np.array(direction)))))
    assert angle < 8.0


@pytest.mark.slow
def test_it_names_far_more_faults_of_a_six_axis_arm_than_a_guess() -> None:
    arm = six_axis()
    sampler = FaultSampler(LinearArm(arm), Difficulty())
    rng = np.random.default_rng(31)
    faults = [sampler.draw(rng) for _ in range(24)]
    posterior = FaultPosterior(LinearArm(arm), SensorSuite())
    right, log_score = scored(posterior, faults, played(arm, faults, 4, seed=32))
    assert right >= 14  # of 24; always saying healthy is right on about 8
    assert log_score > -1.4  # knowing only the prior scores -2.29


@pytest.mark.slow
@pytest.mark.parametrize("make", [planar, vera])
def test_it_finds_an_open_gap_and_knows_nothing_of_a_shut_one(make: Callable[[], Arm]) -> None:
    arm = make()
    linear, places = LinearArm(arm), hypotheses(arm)[1:]
    # The narrowest that the default difficulty draws: an arm in a wider gap rattles less.
    ranges = Difficulty(friction=(0.02, 0.02), gap=(2e-5, 2e-5))
    sampler, mismatch = FaultSampler(linear, ranges), Mismatch().draw(arm, np.random.default_rng(5))
    faults = [sampler.draw(np.random.default_rng(3), hypothesis=place) for place in places]
    posterior = FaultPosterior(linear, SensorSuite())

    def diagnosed(factor: float) -> np.ndarray:
        """Probabilities, healthy arm first, with gaps and compliances closed by a factor."""
        closed: list[Any] = [Healthy()]
        for fault in faults:
            changes: dict[str, Any] = {"gap": fault.gap * factor}  # type: ignore[union-attr]
            for name, by in (("stiffness", 1 / factor), ("damping", 1 / np.sqrt(factor))):
                changes[name] = tuple(by * each for each in getattr(fault, name))
            closed.append(dataclasses.replace(fault, **changes))
        finer = int(np.ceil(1 / np.sqrt(factor)))  # a stiffer stop needs a smaller step
        rig = SimulatedRig(arm, slots=len(closed), timestep=arm.timestep / finer)
        for slot, fault in enumerate(closed):
            rig.mount(slot, fault, mismatch)
        records: list[list[RecordStatistics]] = [[] for _ in closed]
        for k, pose in enumerate(([0.4, -0.7, 0.9, 0.5], [-1.0, 1.4, -0.6, 1.2])):
            q = np.array(pose[: arm.n])
            for joint in (0, arm.n - 1):
                levels = arm.levels[-1] * (np.arange(arm.n) == joint)
                shake, _ = at_levels(linear.at(q), levels, duration=0.2)
                rngs = [np.random.default_rng(k) for _ in closed]
                found = rig.measure_all(range(len(closed)), q, shake, rngs)
                for own, measured in zip(records, found, strict=True):
                    own.append(statistics_of(measured))
        return np.array([after(posterior, own).probabilities for own in records])

    for place, probabilities in zip(places, diagnosed(1.0)[1:], strict=True):
        assert probabilities[0] < 0.1, place
        assert place_of(posterior.hypotheses[int(np.argmax(probabilities))]) == place_of(place)
    shut = diagnosed(0.01)
    assert (shut[:, 0] > 0.5).all()
    # Were there a fault after all, its place would be as unknown as in the healthy arm, where
    # only those places lose against the prior that would have shown.
    healthy, *others = shut[:, 1:] / shut[:, 1:].sum(axis=1, keepdims=True)
    for place, other in zip(places, others, strict=True):
        assert 0.5 * np.abs(other - healthy).sum() < 0.2, place


def test_several_excited_joints_are_one_record_too() -> None:
    arm = weightless(six_axis())
    linear = LinearArm(arm)
    fault = StructuralLooseness(link=3, direction=(0.6, 0.0, 0.8), gap=0.05, stiffness=(1e4, 1e4))
    rig = SimulatedRig(arm)
    rig.mount(0, fault)
    pose = np.array([0.2, -0.9, 0.7, 0.4, 0.8, 0.1])
    excitation, _ = at_levels(linear.at(pose), np.full(6, arm.levels[-1]), duration=1.2)
    posterior = FaultPosterior(linear, SensorSuite())
    belief = posterior.update(posterior.start(), statistics_of(rig.measure(pose, excitation)))
    assert posterior.hypotheses[int(np.argmax(belief.probabilities))].endswith("link3")
