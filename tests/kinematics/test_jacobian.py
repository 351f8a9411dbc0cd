"""The Jacobian against MuJoCo's, and what a displaced seat changes in it."""

import mujoco
import numpy as np
import pytest

from loose_env.arms import planar, vera
from loose_env.errors import InvalidData, InvalidSetting, UnknownName
from loose_env.kinematics.chain import Chain
from loose_env.kinematics.jacobian import (
    changed_columns,
    geometric_jacobian,
    link_of_changed_columns,
    tool_velocity,
    velocity_error,
)
from loose_env.thesis.methods.looseness.looseness_joint import (
    displaced,
    insert_looseness,
    looseness_transform,
    slot_direction,
)


def spatial(seed: int = 3) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Build a spatial arm of five hinges and a slide, axes and offsets at random."""
    rng = np.random.default_rng(seed)
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    body = spec.worldbody
    for k in range(6):
        body = body.add_body(name=f"b{k}", pos=rng.normal(0, 0.3, 3), mass=1.0, inertia=[1, 1, 1])
        body.add_joint(
            name=f"j{k}",
            type=mujoco.mjtJoint.mjJNT_SLIDE if k == 3 else mujoco.mjtJoint.mjJNT_HINGE,
            axis=rng.normal(size=3),
            pos=rng.normal(0, 0.1, 3),
        )
    body.add_site(name="tool", pos=rng.normal(0, 0.2, 3), quat=rng.normal(size=4))
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:] = rng.normal(size=6)
    mujoco.mj_forward(model, data)
    return model, data


def chain_of(data: mujoco.MjData) -> Chain:
    return Chain(
        kinds=tuple("prismatic" if k == 3 else "revolute" for k in range(6)),
        axes=data.xaxis,
        anchors=data.xanchor,
        tool=data.site("tool").xpos,
        tool_axes=data.site("tool").xmat.reshape(3, 3),
    )


def mujoco_jacobian(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    linear, angular = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    mujoco.mj_jacSite(model, data, linear, angular, model.site("tool").id)
    return np.vstack([linear, angular])


def test_it_is_mujocos_on_a_spatial_arm_in_both_frames():
    model, data = spatial()
    expected = mujoco_jacobian(model, data)
    chain = chain_of(data)
    np.testing.assert_allclose(geometric_jacobian(chain), expected, atol=1e-12)
    turn = np.kron(np.eye(2), data.site("tool").xmat.reshape(3, 3).T)
    np.testing.assert_allclose(geometric_jacobian(chain, "tool"), turn @ expected, atol=1e-12)


@pytest.mark.parametrize("arm", [planar(3), vera()], ids=lambda a: a.name)
def test_the_chain_of_an_arm_is_mujocos(arm):
    pose = np.linspace(0.3, 1.1, arm.n)
    data = mujoco.MjData(arm.model)
    data.qpos[arm.pose_addresses] = pose
    mujoco.mj_forward(arm.model, data)
    dofs = [arm.model.joint(j).dofadr[0] for j in arm.joints]
    expected = mujoco_jacobian(arm.model, data)[:, dofs]
    np.testing.assert_allclose(geometric_jacobian(Chain.of(arm, pose)), expected, atol=1e-12)


def test_the_inserted_column_is_the_derivative_by_the_seat():
    _, data = spatial()
    chain, axis, step = chain_of(data), np.array([0.3, -0.5, 0.8]), 1e-6
    for kind in ("prismatic", "revolute"):
        column = geometric_jacobian(insert_looseness(chain, 2, axis, kind=kind))[:3, 2]
        ends = [displaced(chain, 2, axis, s * step, kind=kind).tool for s in (1, -1)]
        np.testing.assert_allclose(column, (ends[0] - ends[1]) / (2 * step), atol=1e-8)


def test_which_columns_change_depends_on_the_point_and_names_the_link():
    arm = planar(4)
    chain = Chain.of(arm, [0.2, 0.5, -0.8, 0.6])
    for link in range(1, 5):
        loose = displaced(chain, link, [1, 2, 0], 2e-4)
        for frame in ("tool", "world", "base"):
            changed = changed_columns(
                geometric_jacobian(chain, frame), geometric_jacobian(loose, frame), tolerance=1e-9
            )
            proximal = np.arange(1, 5) <= link
            assert changed.tolist() == (~proximal if frame == "base" else proximal).tolist()
            found = link_of_changed_columns(changed, frame)
            assert found == (0 if frame == "base" and link == 4 else link)


def test_a_hinge_leaves_the_distal_columns_only_in_tool_coordinates():
    chain = Chain.of(planar(3), [0.2, 0.5, -0.8])
    loose = displaced(chain, 2, [0, 0, 1], 1e-3, kind="revolute")
    for frame, expected in (("tool", [True, False, False]), ("world", [True, True, True])):
        changed = changed_columns(
            geometric_jacobian(chain, frame), geometric_jacobian(loose, frame), tolerance=1e-9
        )
        # Column 2 is that of the hinge itself, on the same axis: in tool axes it stays too.
        assert changed.tolist() == expected


def test_a_slide_adds_a_rank_and_play_does_not():
    chain = Chain.of(planar(2), [0.3, 0.9])
    rank = np.linalg.matrix_rank
    assert rank(geometric_jacobian(chain)) == 2
    assert rank(geometric_jacobian(insert_looseness(chain, 2, [1, 0, 0]))) == 3
    play = insert_looseness(chain, 2, [0, 0, 1], kind="revolute")
    assert rank(geometric_jacobian(play)) == 2


def test_the_velocity_error_is_the_seats_motion():
    chain = Chain.of(planar(3), [0.3, 0.9, 0.1])
    loose = insert_looseness(chain, 1, [0, 1, 0])
    error = velocity_error(
        geometric_jacobian(chain), [1, 2, 3], geometric_jacobian(loose), [1, 0.05, 2, 3]
    )
    np.testing.assert_allclose(error, [0, 0.05, 0, 0, 0, 0], atol=1e-15)


def test_the_looseness_transform_leaves_the_neighbours_parameters():
    def dh(a: float, alpha: float, d: float, theta: float) -> np.ndarray:
        ca, sa, ct, st = np.cos(alpha), np.sin(alpha), np.cos(theta), np.sin(theta)
        return np.array(
            [
                [ct, -st * ca, st * sa, a * ct],
                [st, ct * ca, -ct * sa, a * st],
                [0, sa, ca, d],
                [0, 0, 0, 1],
            ]
        )

    first, second = dh(0.4, 0.3, 0.1, 0.7), dh(0.2, -1.1, 0.0, 0.4)
    direction = slot_direction([0, 0, 1], [np.cos(0.6), np.sin(0.6), 0])
    np.testing.assert_allclose(direction, [-np.sin(0.6), np.cos(0.6), 0], atol=1e-15)
    at_rest = first @ looseness_transform(direction, 0.0) @ second
    np.testing.assert_allclose(at_rest, first @ second, atol=1e-14)
    moved = first @ looseness_transform(direction, 0.01) @ second
    np.testing.assert_allclose(moved[:3, :3], (first @ second)[:3, :3], atol=1e-14)
    np.testing.assert_allclose(
        moved[:3, 3] - at_rest[:3, 3], 0.01 * first[:3, :3] @ direction, atol=1e-14
    )


def test_bad_input_is_refused():
    chain = Chain.of(planar(2), [0.0, 0.1])
    with pytest.raises(InvalidSetting, match="2 finite numbers"):
        Chain.of(planar(2), [0.0, np.nan])
    with pytest.raises(UnknownName, match="links 1 to 2"):
        insert_looseness(chain, 3, [1, 0, 0])
    with pytest.raises(UnknownName, match="'world', 'tool' or 'base'"):
        geometric_jacobian(chain, "flange")
    with pytest.raises(InvalidData, match="one block"):
        link_of_changed_columns([False, True], "tool")
    with pytest.raises(InvalidData, match="perpendicular"):
        slot_direction([0, 0, 1], [1, 0, 1])
    with pytest.raises(InvalidData, match="one rate"):
        tool_velocity(np.eye(2), [1.0])
