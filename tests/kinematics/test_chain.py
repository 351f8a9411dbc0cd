"""The chain and its Jacobian against MuJoCo's."""

import mujoco
import numpy as np
import pytest

from loose_env.arms import planar, vera
from loose_env.errors import InvalidSetting, UnknownName
from loose_env.kinematics import Chain, geometric_jacobian


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


def test_bad_input_is_refused():
    with pytest.raises(InvalidSetting, match="2 finite numbers"):
        Chain.of(planar(2), [0.0, np.nan])
    with pytest.raises(UnknownName, match="'world', 'tool' or 'base'"):
        geometric_jacobian(Chain.of(planar(2), [0.0, 0.1]), "flange")
