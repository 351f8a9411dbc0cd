"""What bending does to a change of transmission: VERA's first mode lies in its band."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from loose_env.arms import LinearArm, Mismatch, planar, scara, six_axis, vera
from loose_env.diagnosis.records.model_uncertainty import bent_by_seats, stiffness_errors
from loose_env.diagnosis.research.sequential.transmission_change import change_of_transmission
from loose_env.excitation import at_levels
from loose_env.faults import Healthy, StructuralLooseness
from loose_env.rig import SimulatedRig
from loose_env.statistics import change_direction

BELOW = (8.0, 36.0)
POSE = np.array([0.3, 1.0])


def test_the_nominal_arm_answers_in_the_band_that_was_played() -> None:
    arm = vera()
    linear = LinearArm(arm)
    low = linear.variant(replace(arm, band=BELOW))
    rig = SimulatedRig(arm, threads=1)
    shake, _ = at_levels(low.at(POSE), np.array([0.4, 0.0]), duration=1.2)
    assert shake.band == BELOW
    change = change_of_transmission(linear, [rig.measure(POSE, shake)])
    assert change.ratio < 0.03
    in_other_band = linear.at(POSE).response(shake.excited)
    x = in_other_band.joint[:, :1].real.mean(axis=0)
    other = in_other_band.tool.real.mean(axis=0) / x
    assert np.linalg.norm(other - change.reference) > 0.1 * np.linalg.norm(change.reference)


def test_a_stiff_arm_is_bent_little_and_less_at_low_frequencies() -> None:
    for arm in (planar(3), six_axis(), scara()):
        linear = LinearArm(arm)
        low = linear.variant(replace(arm, band=BELOW))
        pose = arm.random_pose(np.random.default_rng(0))
        one = np.arange(arm.n) == 0
        bent = np.abs(bent_by_seats(linear.at(pose), one)).max()
        assert np.isfinite(bent)
        assert bent < 0.1
        assert np.abs(bent_by_seats(low.at(pose), one)).max() < 0.02
    slow = LinearArm(vera()).variant(replace(vera(), band=BELOW)).at(POSE)
    assert np.abs(bent_by_seats(slow, np.array([True, False]))).max() > 0.03


def test_errors_of_springs_are_those_of_an_arm_with_other_springs() -> None:
    arm, one = vera(), np.array([True, False])
    pose, mismatch = POSE, Mismatch(stiffness=0.1, mass=0.0)
    errors = stiffness_errors(LinearArm(arm), pose, one, mismatch)
    assert errors.shape == (2, 2, 1)  # the bending mode, and the brake of joint 2
    found = []
    for factor in (1.1, 1 / 1.1):
        spec = arm.spec.copy()
        for joint in spec.joints:
            if joint.name not in arm.joints:
                joint.stiffness = joint.stiffness * factor
        answer = LinearArm(replace(arm, spec=spec)).at(pose).response(one)
        found.append(answer.tool.real.mean(axis=0) / answer.joint[:, :1].real.mean(axis=0))
    np.testing.assert_allclose(errors[0], (found[0] - found[1]) / 2, rtol=1e-6)
    assert np.abs(errors[1]).max() < 0.1 * np.abs(errors[0]).max()


@pytest.mark.parametrize("reference", ["healthy", "nominal"])
def test_regions_of_a_bending_arm_hold_the_truth(reference: str) -> None:
    arm = vera()
    low = LinearArm(arm).variant(replace(arm, band=BELOW))
    rig = SimulatedRig(arm, slots=2, threads=1)
    held = []
    for case in range(14):
        rng = np.random.default_rng(case)
        angle, link, pose = rng.uniform(0, np.pi), 1 + case % 2, arm.random_pose(rng)
        fault = StructuralLooseness(
            link=link,
            direction=(float(np.cos(angle)), float(np.sin(angle)), 0.0),
            gap=2e-4,
            stiffness=(3e5, 3e5),
            damping=(30.0, 30.0),
            friction=0.05,
        )
        mismatch = Mismatch().draw(arm, rng)
        rig.mount(0, fault, mismatch)
        rig.mount(1, Healthy(), mismatch)
        shakes = [
            at_levels(low.at(pose), row, duration=1.2)[0] for row in np.diag(np.full(arm.n, 0.5))
        ]
        now = [rig.measure(pose, shake, rng=rng) for shake in shakes]
        sound = [rig.measure(pose, shake, rng=rng, slot=1) for shake in shakes]
        healthy = sound if reference == "healthy" else None
        change = change_of_transmission(LinearArm(arm), now, healthy=healthy)
        data = mujoco.MjData(arm.model)
        data.qpos[arm.pose_addresses] = pose
        mujoco.mj_kinematics(arm.model, data)
        world = data.body(arm.seat_bodies[link - 1]).xmat.reshape(3, 3) @ fault.direction
        truth = data.site(arm.tool).xmat.reshape(3, 3).T @ world
        found = change_direction(change.estimate)
        held.append(found.contains(truth[list(arm.axes)]))
    assert np.mean(held) >= 0.8
