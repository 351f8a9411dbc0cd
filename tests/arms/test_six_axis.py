"""The six-axis arm against the published kinematics and dynamics of the PUMA 560."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from loose_env.arms import Arm, six_axis
from loose_env.arms.library import TOOL
from loose_env.arms.linear import LinearArm
from loose_env.typing import Array

READY = np.array([0.0, -np.pi / 2, np.pi / 2, 0.0, 0.0, 0.0])
A2, A3, D2, D3, D4 = 0.4318, -0.0203, 0.2435, -0.0934, 0.4331
PRINTED_GRAVITY = 9.80
"""What the printed constants of gravity were worked out with: the fifth has only one mass in it."""
# Constants of the explicit model as printed (Armstrong, Khatib, Burdick 1986) [kg·m²], [N·m].
J = dict(
    enumerate(
        [
            *(1.43, 1.75, 1.38, 0.69, 0.372, 0.333, 0.298, -0.134, 0.0238, -0.0213, -0.0142),
            *(-0.011, -0.00379, 0.00164, 0.00125, 0.00124, 0.000642, 0.000431, 0.0003),
            *(-0.000202, -0.0001, -0.000058, 0.00004),
        ],
        start=1,
    )
)
ROTOR = (1.14, 4.71, 0.827, 0.200, 0.179, 0.193)
G = np.array([-37.2, -8.44, 1.02, 0.249, -0.0282])
LAST_PLACE = np.array([0.1, 0.01, 0.01, 0.001, 0.0001])
LINK_3_MENDED = 0.0026


@pytest.fixture(scope="module")
def arm() -> Arm:
    return six_axis()


@pytest.fixture(scope="module")
def linear(arm: Arm) -> LinearArm:
    return LinearArm(arm)


def frame_of_link_6(pose: Array) -> Array:
    """Place of link 6 from the modified Denavit-Hartenberg parameters (4, 4)."""
    place = np.eye(4)
    for (alpha, a, d), theta in zip(
        [
            *((0, 0, 0), (-np.pi / 2, 0, D2), (0, A2, D3)),
            *((np.pi / 2, A3, D4), (-np.pi / 2, 0, 0), (np.pi / 2, 0, 0)),
        ],
        pose,
        strict=True,
    ):
        ct, st, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
        place = place @ np.array(
            [
                [ct, -st, 0, a],
                [st * ca, ct * ca, -sa, -d * sa],
                [st * sa, ct * sa, ca, d * ca],
                [0, 0, 0, 1],
            ]
        )
    return place


def placed(arm: Arm, pose: Array) -> mujoco.MjData:
    data = mujoco.MjData(arm.model)
    data.qpos[arm.pose_addresses] = pose
    mujoco.mj_forward(arm.model, data)
    return data


def inertia_at(linear: LinearArm, pose: Array) -> Array:
    return linear.at(pose).inertia[np.ix_(linear.joint_dofs, linear.joint_dofs)]


# --- kinematics


@pytest.mark.parametrize(
    ("pose", "wrist"),
    [
        (np.zeros(6), (A2 + A3, D2 + D3, D4)),
        (READY, (A3, D2 + D3, A2 + D4)),
        (np.array([0, 0, np.pi / 2, 0, 0, 0]), (A2 + D4, D2 + D3, -A3)),
    ],
    ids=["zero", "ready", "stretched"],
)
def test_the_wrist_lies_where_its_parameters_put_it(
    arm: Arm, pose: Array, wrist: tuple[float, ...]
) -> None:
    np.testing.assert_allclose(placed(arm, pose).body("link6").xpos, wrist, atol=1e-9)


def test_the_tool_follows_the_denavit_hartenberg_parameters(arm: Arm) -> None:
    rng = np.random.default_rng(1)
    for pose in (np.zeros(6), READY, *(arm.random_pose(rng) for _ in range(20))):
        data, place = placed(arm, pose), frame_of_link_6(pose)
        np.testing.assert_allclose(data.site("tool").xpos, (place @ [*TOOL, 1])[:3], atol=1e-9)
        np.testing.assert_allclose(data.site("tool").xmat.reshape(3, 3), place[:3, :3], atol=1e-9)


def test_the_wrist_reaches_878_mm_from_the_shoulder(arm: Arm) -> None:
    straight = np.pi / 2 - np.arctan2(A3, D4)
    reach = [
        np.linalg.norm(placed(arm, np.array([0, 0, q, 0, 0, 0.0])).body("link6").xpos)
        for q in (straight - 0.05, straight, straight + 0.05)
    ]
    assert max(reach) == reach[1] == pytest.approx(0.878, abs=5e-4)


# --- dynamics


def test_gravity_torques_have_the_printed_form_and_constants(arm: Arm, linear: LinearArm) -> None:
    rng = np.random.default_rng(2)
    rows, torques = [], []
    for _ in range(30):
        q = arm.random_pose(rng)
        c2, s2, c23, s23 = np.cos(q[1]), np.sin(q[1]), np.cos(q[1] + q[2]), np.sin(q[1] + q[2])
        c4, s4, c5, s5 = np.cos(q[3]), np.sin(q[3]), np.cos(q[4]), np.sin(q[4])
        wrist = s23 * c5 + c23 * c4 * s5
        rows += [
            [0, 0, 0, 0, 0],
            [c2, s23, s2, c23, wrist],
            [0, s23, 0, c23, wrist],
            [0, 0, 0, 0, -s23 * s4 * s5],
            [0, 0, 0, 0, c23 * s5 + s23 * c4 * c5],
            [0, 0, 0, 0, 0],
        ]
        torques.append(linear.at(q).gravity_torque)
    form, torque = np.array(rows), np.concatenate(torques)
    constants = np.linalg.lstsq(form, torque, rcond=None)[0]
    np.testing.assert_allclose(form @ constants, torque, atol=1e-9)
    assert (np.abs(constants * PRINTED_GRAVITY / 9.81 - G) < LAST_PLACE).all()


@pytest.mark.parametrize("q2", [-np.pi / 2, -1.0, 0.0, 0.4])
@pytest.mark.parametrize("q3", [-0.6, 0.0, np.pi / 2])
def test_inertia_is_that_of_the_printed_explicit_model(
    linear: LinearArm, q2: float, q3: float
) -> None:
    # The short form of the model, wrist straight.
    c2, s2, c3, s3 = np.cos(q2), np.sin(q2), np.cos(q3), np.sin(q3)
    c23, s23 = np.cos(q2 + q3), np.sin(q2 + q3)
    found = inertia_at(linear, np.array([0.3, q2, q3, 0, 0, 0]))
    a13 = J[8] * c23 + J[13] * s23 - J[18] * c23
    a23 = J[5] * s3 + J[6] + J[12] * c3 + J[16] * s3 + 2 * J[15]
    a22 = ROTOR[1] + J[2] + J[6] + 2 * (J[5] * s3 + J[12] * c3 + J[15] + J[16] * s3)
    # Half a unit in the last place of every constant that counts, and the change to link 3.
    for value, place, rounding in (
        (J[4] * s2 + J[9] * c2 + a13, (0, 1), 6e-3),
        (a13, (0, 2), 5.1e-4),
        (a22, (1, 1), 0.012 + LINK_3_MENDED),
        (a23, (1, 2), 1.5e-3 + LINK_3_MENDED),
        (ROTOR[2] + J[6] + 2 * J[15], (2, 2), 1.1e-3 + LINK_3_MENDED),
        (J[15] + J[17], (2, 4), 1e-5),
        (ROTOR[3] + J[14], (3, 3), 5e-4),
        (ROTOR[4] + J[17], (4, 4), 5e-4),
        (ROTOR[5] + J[23], (5, 5), 5e-4),
    ):
        assert found[place] == pytest.approx(value, abs=rounding), place


def test_inertia_about_joint_1_is_that_of_the_printed_links(linear: LinearArm) -> None:
    rng = np.random.default_rng(5)
    rows, found = [], []
    for q2, q3 in rng.uniform(-np.pi, np.pi, (40, 2)):
        c2, s2, c23, s23 = np.cos(q2), np.sin(q2), np.cos(q2 + q3), np.sin(q2 + q3)
        rows.append([1, c2**2, s23**2, s23 * c23, s2 * c2, c2 * s23, c2 * c23])
        found.append(inertia_at(linear, np.array([0, q2, q3, 0, 0, 0]))[0, 0])
    form, inertia = np.array(rows), np.array(found)
    constants = np.linalg.lstsq(form, inertia, rcond=None)[0]
    np.testing.assert_allclose(form @ constants, inertia, atol=1e-9)
    printed = [J[7] + J[21] + 2 * J[15], J[10] + 2 * J[22], J[11], 2 * (J[5] + J[16]), 2 * J[12]]
    rounding = [6e-4, 1e-4, 1e-4, 1.1e-3, 1.1e-3]  # link 3 is moved alike about all its axes
    assert (np.abs(constants[2:] - printed) < rounding).all()
    # The printed I1 and I3 do not follow from the printed links; these do.
    links_1 = 0.35 + 0.130 + 17.4 * ((D2 - 0.016) ** 2 + 0.006**2)
    links_1 += 0.0125 + LINK_3_MENDED + 4.8 * (D2 + D3 + 0.014) ** 2
    links_1 += 1.25 * ((D2 + D3) ** 2 + A3**2) + 0.0013 + 0.0003 + 0.00004
    links_3 = 0.524 - 0.130 + 17.4 * (0.068**2 - 0.006**2) + (4.8 + 1.25) * A2**2
    assert constants[0] == pytest.approx(ROTOR[0] + links_1, abs=1e-3)
    assert constants[1] == pytest.approx(links_3, abs=1e-3)
    # In every pose they agree within the uncertainties printed beside Im1, I1 and I3.
    apart = constants[:2] - [ROTOR[0] + J[1], J[3]]
    assert 0 < apart[0] < apart.sum() < 0.27 + 0.05 + 0.05


def test_inertia_is_positive_definite_wherever_the_arm_is(arm: Arm, linear: LinearArm) -> None:
    rng = np.random.default_rng(3)
    for _ in range(100):
        inertia = inertia_at(linear, arm.random_pose(rng))
        np.testing.assert_allclose(inertia, inertia.T, atol=1e-12)
        # Never less than the smallest drive's inertia.
        assert np.linalg.eigvalsh(inertia)[0] > min(ROTOR)


def test_the_drives_hold_the_arm_and_have_torque_to_spare(arm: Arm, linear: LinearArm) -> None:
    rng = np.random.default_rng(4)
    gravity = [np.abs(linear.at(arm.random_pose(rng)).gravity_torque) for _ in range(100)]
    assert (np.max(gravity, axis=0) < 0.3 * np.array(arm.torque_limits)).all()


def test_servo_holding_has_its_own_name() -> None:
    soft = six_axis(hold="servo")
    assert soft.name == "six_axis-servo"
    assert max(soft.holding.stiffness) < min(soft.brake.stiffness)
