"""Direction and shape of the motion in one record, on simulated arms."""

from __future__ import annotations

import numpy as np
import pytest

from loose_env.arms import Arm, LinearArm, Mismatch, planar, scara, six_axis, vera
from loose_env.diagnosis import (
    ChangeModel,
    ChangeSighting,
    MotionShape,
    SensorFloor,
    ToolFrames,
    predict,
    shape_of_motion,
    sight_change,
    statistics_of,
    stiffness_errors,
)
from loose_env.envs import Difficulty, FaultSampler
from loose_env.errors import InvalidData
from loose_env.excitation import at_levels
from loose_env.faults import Backlash, Fault, Healthy, StructuralLooseness
from loose_env.rig import Job, ReducedRig, SimulatedRig
from loose_env.sensors import SensorSuite


def sightings(arm: Arm, hypothesis: str | None, count: int, level: int) -> list[tuple]:
    """Sightings of simulated arms with the error of each direction [rad]."""
    rig, frames = SimulatedRig(arm, slots=count, threads=1), ToolFrames(arm)
    floor, model = SensorFloor.of(rig.sensors, arm.band), ChangeModel.of(Mismatch(), joints=arm.n)
    sampler = FaultSampler(rig.nominal, Difficulty(friction=(0.02, 0.1)))
    jobs, faults, expected = [], [], []
    for k in range(count):
        rng = np.random.default_rng([31, k])
        name = hypothesis or f"structural_looseness@link{1 + k % arm.n}"
        faults.append(sampler.draw(rng, hypothesis=name))
        rig.mount(k, faults[-1], Mismatch().draw(arm, rng))
        pose = arm.random_pose(rng)
        levels = np.full(arm.n, arm.levels[level - 1])
        shake, _ = at_levels(rig.nominal.at(pose), levels, duration=1.2)
        jobs.append(Job(slot=k, pose=pose, excitation=shake, rng=rng))
        expected.append(predict(rig.nominal.at(pose), shake, floor))
    found = []
    for job, fault, nominal, record in zip(
        jobs, faults, expected, rig.measure_many(jobs), strict=True
    ):
        seen = sight_change(statistics_of(record), nominal, band=arm.band, floor=floor, model=model)
        error = np.nan
        if fault.kind == "structural_looseness":
            z = np.array(fault.direction)[: frames.dimension]
            true = frames.images(job.pose)[0, fault.link - 1] @ z
            error = float(np.arccos(min(1.0, abs(true @ seen.direction))))
        found.append((seen, error))
    return found


@pytest.mark.parametrize(
    ("arm", "level"),
    [
        (planar(4), 1),
        (six_axis(), 3),
        *(
            pytest.param(arm, level, marks=pytest.mark.slow)
            for arm, level in ((planar(4), 3), (six_axis(), 1), (scara(), 1), (scara(), 3))
        ),
    ],
    ids=lambda each: getattr(each, "name", str(each)),
)
def test_a_healthy_arm_changes_by_what_errors_leave(arm: Arm, level: int) -> None:
    seen: list[ChangeSighting] = [s for s, _ in sightings(arm, "healthy", 16, level)]
    excess = np.array([s.excess for s in seen])
    assert 0.4 < np.median(excess) < 1.4
    assert excess.max() < 2.5
    assert sum(s.rank > 0 for s in seen) <= 1


def test_an_open_seat_shows_its_direction_within_the_stated_uncertainty() -> None:
    found = sightings(planar(4), None, 32, 3)
    open_ones = [(s, e) for s, e in found if s.excess > 1.8]
    assert len(open_ones) >= 20
    errors = np.array([e for _, e in open_ones])
    sd = np.array([1 / np.sqrt(np.trace(s.precision)) for s, _ in open_ones])
    assert np.degrees(np.median(errors)) < 5
    assert 0.3 < np.median(errors / sd) < 1.2  # 0.67 for a normal error
    assert np.mean(errors < 3 * sd) > 0.85


def test_a_bending_arm_is_expected_to_differ_by_its_springs() -> None:
    arm, pose, model = vera(), np.array([0.3, 1.0]), ChangeModel()
    rig = SimulatedRig(arm, threads=1)
    floor, at = SensorFloor.of(rig.sensors, arm.band), rig.nominal.at(pose)
    shake, _ = at_levels(at, np.full(arm.n, arm.levels[1]), duration=1.2)
    springs = stiffness_errors(at.alone, np.array([shake.excited]), Mismatch())[0]
    rig.mount(0, Healthy(), Mismatch(stiffness=0.2).draw(arm, np.random.default_rng(0)))
    record = statistics_of(rig.measure(pose, shake))

    def seen(errors: np.ndarray | None) -> ChangeSighting:
        return sight_change(
            record,
            predict(at, shake, floor),
            band=arm.band,
            floor=floor,
            model=model,
            springs=errors,
        )

    with_springs, without = seen(springs), seen(None)
    np.testing.assert_array_equal(seen(springs[:0]).precision, without.precision)
    assert with_springs.excess < without.excess
    assert np.trace(with_springs.precision) < np.trace(without.precision)


ARM = planar(3)
POSE = np.array([0.3, 0.8, -0.6])


SLIDE = StructuralLooseness(
    link=2, direction=(0.0, 1.0, 0.0), gap=1e-4, stiffness=(3e6, 3e6), damping=(200.0, 200.0)
)


def play_in(joint: int) -> Backlash:
    return Backlash(joint=joint, gap=2e-4, stiffness=(2e5, 2e5), damping=(20.0, 20.0), friction=0.1)


def shape(fault: Fault, *joints: int) -> MotionShape:
    linear, rig = LinearArm(ARM), ReducedRig(ARM)
    rig.mount(0, fault)
    levels = np.where(np.isin(np.arange(3), joints), ARM.levels[-1], 0.0)
    shake, _ = at_levels(linear.at(POSE), levels, duration=1.2)
    measured = rig.measure(POSE, shake, rng=np.random.default_rng(0))
    floor = SensorFloor.of(SensorSuite(), ARM.band)
    return shape_of_motion(statistics_of(measured), linear.at(POSE), floor)


@pytest.mark.parametrize(
    ("fault", "across", "normal", "play"),
    [
        (Healthy(), False, True, False),
        (play_in(2), False, False, True),
        (play_in(3), True, False, False),
        (SLIDE, True, False, False),
    ],
    ids=("healthy", "play in the driven joint", "play beyond it", "slide beyond it"),
)
def test_only_play_in_the_driven_joint_keeps_to_the_line_and_is_not_normal(
    fault: Fault, across: bool, normal: bool, play: bool
) -> None:
    found = shape(fault, 1)
    assert (found.across > 5.0) == across
    assert (found.kurtosis < 0.3) == normal
    assert found.is_play() == play


def test_several_driven_joints_are_refused() -> None:
    with pytest.raises(InvalidData, match=r"joints \[1, 2\] were excited: excite one alone"):
        shape(Healthy(), 0, 1)
