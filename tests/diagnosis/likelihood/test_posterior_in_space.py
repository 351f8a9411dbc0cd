"""The posterior on arms in space: directions on the sphere, gravity on the seats."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from loose_env.arms import Arm, LinearArm, arm_from_file, planar, scara, six_axis
from loose_env.diagnosis.likelihood.opening_table import (
    PRESSES,
    RATIOS,
    OpeningTable,
    shipped_table,
)
from loose_env.diagnosis.likelihood.posterior import (
    FaultPosterior,
    PosteriorSettings,
    slide_directions,
)
from loose_env.diagnosis.likelihood.record_likelihood import OPENINGS
from loose_env.diagnosis.records.record_statistics import RecordStatistics, statistics_of
from loose_env.envs import Difficulty, FaultSampler
from loose_env.errors import InvalidSetting
from loose_env.excitation import at_levels
from loose_env.faults import Fault, Healthy, StructuralLooseness
from loose_env.rig import Job, SimulatedRig
from loose_env.sensors import SensorSuite
from tests.diagnosis.likelihood.imagined import imagined_record

UR5E = Path(__file__).resolve().parents[4] / "shared" / "models" / "ur5e_bare.xml"


def arm_named(name: str) -> Arm:
    if name == "ur5e":
        if not UR5E.is_file():
            pytest.skip(f"the UR5e file {UR5E} is not here")
        return arm_from_file(UR5E)
    return {"six_axis": six_axis, "scara": scara}[name]()


def weightless(arm: Arm) -> Arm:
    spec = arm.spec.copy()
    spec.option.gravity = [0, 0, 0]
    return dataclasses.replace(arm, spec=spec)


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
        jobs = []
        for slot in range(len(faults)):
            pose, levels = arm.random_pose(rng), np.zeros(arm.n)
            levels[(slot + k) % (joints or arm.n)] = arm.levels[-1]
            excitation, _ = at_levels(rig.nominal.at(pose), levels, duration=1.2)
            jobs.append(Job(slot=slot, pose=pose, excitation=excitation, rng=rng.spawn(1)[0]))
        for slot, measurement in enumerate(rig.measure_many(jobs)):
            found[slot].append(statistics_of(measurement))
    return found


@pytest.mark.parametrize("count", [48, 96, 192])
def test_directions_cover_the_half_sphere_evenly(count: int) -> None:
    grid = slide_directions(count, 3)
    assert np.linalg.norm(grid, axis=1) == pytest.approx(np.ones(count))
    rng = np.random.default_rng(count)
    anywhere = rng.standard_normal((4000, 3))
    anywhere /= np.linalg.norm(anywhere, axis=1, keepdims=True)
    cosines = np.abs(anywhere @ grid.T)
    # A cap that holds one direction's share of the half sphere has this radius.
    radius = np.arccos(1 - 1 / count)
    assert np.arccos(cosines.max(axis=1).min()) < 1.6 * radius
    nearest = np.bincount(cosines.argmax(axis=1), minlength=count)
    assert nearest.min() > 0.3 * 4000 / count


@pytest.mark.parametrize("name", ["six_axis", "scara", "ur5e"])
def test_a_healthy_arm_without_noise_is_called_healthy(name: str) -> None:
    arm, ideal = arm_named(name), SensorSuite.ideal()
    posterior = FaultPosterior(LinearArm(arm), SensorSuite())
    belief = posterior.start()
    for record in played(arm, [Healthy()], 6, seed=1, sensors=ideal, mismatch=False)[0]:
        belief = posterior.update(belief, record)
    assert posterior.hypotheses[int(np.argmax(belief.probabilities))] == "healthy"
    assert belief.probabilities[0] > 0.6  # its prior was a third


@pytest.mark.parametrize("name", ["six_axis", "ur5e"])
@pytest.mark.parametrize("link", [3, 4])
def test_a_seat_that_floats_is_named_with_its_direction(name: str, link: int) -> None:
    arm = weightless(arm_named(name))
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


def test_it_names_far_more_faults_of_a_six_axis_arm_than_a_guess() -> None:
    arm = six_axis()
    sampler = FaultSampler(LinearArm(arm), Difficulty())
    rng = np.random.default_rng(31)
    faults = [sampler.draw(rng) for _ in range(24)]
    posterior = FaultPosterior(LinearArm(arm), SensorSuite())
    right, log_score = 0, 0.0
    for fault, records in zip(faults, played(arm, faults, 4, seed=32), strict=True):
        belief = posterior.start()
        for record in records:
            belief = posterior.update(belief, record)
        p = belief.probabilities
        truth = posterior.hypotheses.index(fault.hypothesis)
        right += int(np.argmax(p) == truth)
        log_score += float(np.log(max(p[truth], 1e-12)))
    assert right >= 14  # of 24; always saying healthy is right on about 8
    assert log_score / len(faults) > -1.4  # knowing only the prior scores -2.29


def test_the_order_of_records_does_not_matter() -> None:
    linear = LinearArm(six_axis())
    posterior = FaultPosterior(linear, SensorSuite())
    poses = np.random.default_rng(3).uniform(-1, 1, (3, 6))
    records = [
        imagined_record(
            linear, list(pose), joint=joint, link=3, direction=[0.0, 0.6, 0.8], opening=0.7
        )
        for pose, joint in zip(poses, (1, 2, 4), strict=True)
    ]
    there, back = posterior.start(), posterior.start()
    for record in records:
        there = posterior.update(there, record)
    for record in records[::-1]:
        back = posterior.update(back, record)
    assert there.probabilities == pytest.approx(back.probabilities, abs=1e-9)
    assert there.axis(3) == pytest.approx(back.axis(3), abs=1e-9)


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


def test_an_angle_cannot_say_a_direction_in_space() -> None:
    belief = FaultPosterior(LinearArm(six_axis()), SensorSuite()).start()
    with pytest.raises(InvalidSetting, match="axis"):
        belief.direction(1)
    assert np.linalg.norm(belief.axis(1)) == pytest.approx(1.0)


def test_in_the_plane_angle_and_axis_agree() -> None:
    linear = LinearArm(planar(3))
    posterior = FaultPosterior(linear, SensorSuite())
    record = imagined_record(
        linear, [0.3, -0.8, 1.1], joint=1, link=3, direction=[0.0, 1.0], opening=1.0
    )
    belief = posterior.update(posterior.start(), record)
    x, y, z = belief.axis(3)
    assert z == 0.0
    turn = np.degrees(np.arctan2(y, x) - belief.direction(3))
    assert (turn + 90) % 180 - 90 == pytest.approx(0.0, abs=6.0)


def test_gravity_keeps_a_driven_seat_from_opening() -> None:
    table = shipped_table()
    driven = RATIOS > 4.0
    for part in (table.slide, table.hinge):
        opened = np.einsum("hrsq,s->hr", part, OPENINGS)[:, driven].mean(axis=1)
        assert opened[0] > 0.08
        assert (opened[PRESSES >= 0.5] < 0.3 * opened[0]).all()


def test_places_between_nodes_share_their_weight() -> None:
    force = np.array([0.0, 1e-3, 2.0, 2.0, 1e6])
    friction, load = np.ones(5), np.array([0.0, 1.0, 0.0, 3.0, 1e9])
    nodes = OpeningTable.nodes(force, friction, load)
    assert sum(weight for _, weight in nodes) == pytest.approx(np.ones(5))
    for node, weight in nodes:
        assert ((node >= 0) & (node < len(PRESSES) * len(RATIOS))).all()
        assert (weight >= 0).all()
    # The mean of the nodes' own ratio and press is that of the seat.
    ratio = sum(w * np.log(RATIOS[n % len(RATIOS)]) for n, w in nodes)
    assert ratio[2:4] == pytest.approx(np.log([2.0, 2.0]))
    press = sum(w * PRESSES[n // len(RATIOS)] for n, w in nodes)
    assert press[2:4] == pytest.approx([0.0, 0.6])


def test_kinds_without_a_model_are_refused() -> None:
    kinds = {"healthy": 0.5, "compound_looseness": 0.5}
    with pytest.raises(InvalidSetting, match="compound_looseness"):
        PosteriorSettings(kinds=kinds)
