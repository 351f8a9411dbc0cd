"""The change of transmission of simulated arms: direction, errors of sensors, stopping."""

from __future__ import annotations

from functools import partial

import mujoco
import numpy as np
import pytest

from loose_env.arms import Arm, LinearArm, Mismatch, MismatchDraw, planar, six_axis
from loose_env.diagnosis.records.model_uncertainty import (
    calibrate_sensor,
    kinematic_errors,
    sensor_errors,
)
from loose_env.diagnosis.research.sequential.stopping_rule import (
    Ending,
    StoppingRule,
    measure_direction,
)
from loose_env.diagnosis.research.sequential.transmission_change import (
    change_of_transmission,
    measured_transmission,
)
from loose_env.errors import InvalidData, InvalidSetting, UnknownName
from loose_env.excitation import Excitation, at_levels
from loose_env.faults import Healthy, StructuralLooseness
from loose_env.rig import Measurement, SimulatedRig
from loose_env.statistics import TransmissionEstimate, axial_angle_between, change_direction

POSES = {
    "six_axis": np.array([0.3, -0.9, 0.8, 0.4, 0.7, -0.5]),
    "planar": np.array([0.3, 0.9, -0.7]),
}
ARMS = {"six_axis": six_axis(), "planar": planar(3)}


def across_gravity(arm: Arm, pose: np.ndarray, link: int) -> tuple[np.ndarray, np.ndarray]:
    """A direction of a link's frame across gravity, and the same in the tool's axes."""
    data = mujoco.MjData(arm.model)
    data.qpos[arm.pose_addresses] = pose
    mujoco.mj_kinematics(arm.model, data)
    frame = data.body(arm.seat_bodies[link - 1]).xmat.reshape(3, 3)
    tool = data.site(arm.tool).xmat.reshape(3, 3)
    world = np.array([0.6, 0.8, 0.0])
    return frame.T @ world, (tool.T @ world)[list(arm.axes)]


def loose(arm: Arm, direction: np.ndarray, link: int) -> StructuralLooseness:
    return StructuralLooseness(
        link=link,
        direction=(float(direction[0]), float(direction[1]), float(direction[2])),
        gap=2e-4,
        stiffness=(3e5, 3e5),
        damping=(30.0, 30.0),
        friction=0.2,
    )


def shakes(linear: LinearArm, pose: np.ndarray, level: float) -> list[Excitation]:
    wanted = np.diag(np.full(linear.arm.n, level))
    made = [at_levels(linear.at(pose), row, duration=1.2)[0] for row in wanted]
    return [shake for shake in made if any(shake.torque_rms)]


@pytest.mark.parametrize("name", ["six_axis", "planar"])
def test_the_direction_of_a_loose_link(name: str) -> None:
    arm, pose, link = ARMS[name], POSES[name], 3
    linear = LinearArm(arm)
    direction, truth = across_gravity(arm, pose, link)
    rng = np.random.default_rng(1)
    mismatch = Mismatch().draw(arm, rng)
    rig = SimulatedRig(arm, slots=2, threads=1)
    rig.mount(0, loose(arm, direction, link), mismatch)
    rig.mount(1, Healthy(), mismatch)
    played = shakes(linear, pose, 4.0)
    now = [rig.measure(pose, shake, rng=rng) for shake in played]
    before = [rig.measure(pose, shake, rng=rng, slot=1) for shake in played]
    for healthy in (before, None):
        change = change_of_transmission(linear, now, healthy=healthy)
        found = change_direction(change.estimate)
        assert change.ratio > 0.1
        assert np.degrees(axial_angle_between(found.direction, truth)) < 3.0
        assert found.contains(truth)
        assert found.half_angle < np.radians(15.0)
    sound = change_of_transmission(linear, before)
    assert change_direction(sound.estimate).evidence < change_direction(change.estimate).evidence


def test_known_errors_of_a_true_arm_are_those_predicted() -> None:
    """Each joint zero and length moves the Jacobian as said, by numbers from another arm."""
    arm = ARMS["six_axis"]
    pose = POSES["six_axis"]
    errors = kinematic_errors(LinearArm(arm), pose, Mismatch(length=0.01, joint_zero=1.0))
    none = MismatchDraw.none(arm)
    rng = np.random.default_rng(2)
    for k in range(arm.n):
        moved = pose.copy()
        moved[k] += np.radians(1.0)
        exact = LinearArm(arm).at(moved).kinematic - LinearArm(arm).at(pose).kinematic
        np.testing.assert_allclose(errors[k], exact, atol=3e-3 * arm.reach)
    # All lengths together: the sum over links of what each length does.
    factors = np.array(none.length)
    factors[1:] = 1.01
    spec = arm.spec.copy()
    longer = spec.compile()
    longer.body_pos[1:] *= 1.01
    longer.site_pos *= 1.01
    data = mujoco.MjData(longer)
    data.qpos[arm.pose_addresses] = pose
    mujoco.mj_forward(longer, data)
    jacobian = np.zeros((3, longer.nv))
    mujoco.mj_jacSite(longer, data, jacobian, None, longer.site(arm.tool).id)
    tool = data.site(arm.tool).xmat.reshape(3, 3)
    exact = tool.T @ jacobian - LinearArm(arm).at(pose).kinematic
    np.testing.assert_allclose(errors[arm.n :].sum(axis=0), exact, atol=1e-9)
    b = rng.standard_normal((3, 2))
    assert len(sensor_errors(b, Mismatch())) == 12


def test_healthy_records_calibrate_the_accelerometer() -> None:
    rng = np.random.default_rng(3)
    linear = LinearArm(ARMS["six_axis"])
    pose = POSES["six_axis"]
    nominal = linear.at(pose).kinematic
    mismatch = Mismatch()
    kinematic = kinematic_errors(linear, pose, mismatch)
    better = []
    for _ in range(40):
        sensor = mismatch.draw(linear.arm, rng).sensor
        model = np.einsum("k,kij->ij", rng.standard_normal(len(kinematic)), kinematic)
        read = sensor @ (nominal + model)
        estimate = TransmissionEstimate(read, 1e-8 * np.eye(18).reshape(3, 6, 3, 6))
        found, left = calibrate_sensor(estimate, nominal, kinematic, mismatch)
        better.append(np.linalg.norm(found - sensor) / np.linalg.norm(np.eye(3) - sensor))
        claimed = np.sqrt(np.mean(np.sum(left**2, axis=0)))
        assert np.abs(found - sensor).max() < 5 * claimed
    assert np.median(better) < 0.6


def test_what_cannot_be_compared_is_refused() -> None:
    arm, pose = ARMS["planar"], POSES["planar"]
    linear = LinearArm(arm)
    rig = SimulatedRig(arm, threads=1)
    first, second = shakes(linear, pose, 4.0)[:2]
    record, other = rig.measure(pose, first), rig.measure(pose, second)
    with pytest.raises(InvalidData, match="no record"):
        change_of_transmission(linear, [])
    with pytest.raises(InvalidData, match="one pose"):
        change_of_transmission(linear, [record, rig.measure(pose + 0.1, second)])
    with pytest.raises(InvalidData, match="no healthy record excites"):
        change_of_transmission(linear, [record], healthy=[other])
    with pytest.raises(UnknownName, match="instrument"):
        measured_transmission(record, instrument="gyroscope")  # type: ignore[arg-type]


def slot_measure(
    rig: SimulatedRig, pose: np.ndarray, rng: np.random.Generator, shake: Excitation
) -> Measurement:
    return rig.measure(pose, shake, rng=rng)


def test_it_measures_as_long_as_the_angle_needs() -> None:
    arm, pose = ARMS["planar"], POSES["planar"]
    linear = LinearArm(arm)
    direction, truth = across_gravity(arm, pose, 2)
    rig = SimulatedRig(arm, threads=1)
    rig.mount(0, loose(arm, direction, 2))
    played = shakes(linear, pose, 3.0)
    seconds = {}
    for wanted in (12.0, 6.0):
        measure = partial(slot_measure, rig, pose, np.random.default_rng(5))
        rule = StoppingRule(half_angle=float(np.radians(wanted)), longest=6.0)
        found = measure_direction(measure, linear, played, rule=rule)
        seconds[wanted] = found.seconds
        if found.ending is Ending.REACHED:
            assert found.direction.half_angle <= np.radians(wanted)
            assert np.degrees(axial_angle_between(found.direction.direction, truth)) < wanted
        assert len(found.records) % len(played) == 0
        assert found.seconds <= 6.0 + 1e-9
    assert seconds[12.0] <= seconds[6.0]
    exact = measure_direction(
        partial(slot_measure, rig, pose, np.random.default_rng(5)),
        linear,
        played,
        rule=StoppingRule(half_angle=float(np.radians(0.05)), longest=6.0),
    )
    assert exact.ending is Ending.FLOOR
    assert exact.floor > np.radians(0.05)


def test_a_sound_arm_spends_its_time() -> None:
    arm, pose = ARMS["planar"], POSES["planar"]
    linear = LinearArm(arm)
    rig = SimulatedRig(arm, threads=1)
    measure = partial(slot_measure, rig, pose, np.random.default_rng(6))
    rule = StoppingRule(longest=1.0)
    found = measure_direction(measure, linear, shakes(linear, pose, 3.0), rule=rule)
    assert found.ending is Ending.SPENT
    assert found.direction.half_angle > np.radians(60.0)
    with pytest.raises(InvalidSetting, match="half_angle"):
        StoppingRule(half_angle=0.0)
    with pytest.raises(InvalidSetting, match="first"):
        StoppingRule(first=2.0, longest=1.0)
