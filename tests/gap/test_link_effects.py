"""What the effects of links, payload and base do, against formulas of their own."""

from __future__ import annotations

from math import cos

import mujoco
import numpy as np
import pytest

from loose_env.gap import Effect
from loose_env.gap.model.effects.catalogue import CATALOGUE, candidates
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.typing import Array
from tests.gap.cases.effect_arms import ARMS, machine_of


def edited(effect: Effect, *values: float) -> mujoco.MjModel:
    spec = effect.machine.fresh()
    effect.edit(spec, np.array(values))
    return spec.compile()


def poses(machine: NominalModel, count: int = 4) -> Array:
    model = machine.model
    spread = np.where(model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE, 0.05, 0.6)
    return np.asarray(
        model.qpos0 + spread * np.random.default_rng(5).uniform(-1, 1, (count, model.nq))
    )


def posed(model: mujoco.MjModel, machine: NominalModel, pose: Array) -> mujoco.MjData:
    """The machine's joints in a pose, whatever was added at zero."""
    data = mujoco.MjData(model)
    for name, value in zip(machine.joints, pose, strict=True):
        data.joint(name).qpos[0] = value
    mujoco.mj_forward(model, data)
    return data


def inertia(model: mujoco.MjModel, data: mujoco.MjData, machine: NominalModel) -> Array:
    """Mass matrix of the machine's joints, whatever was added held."""
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    own = [int(model.joint(name).dofadr[0]) for name in machine.joints]
    return full[np.ix_(own, own)]


def gravity(model: mujoco.MjModel, machine: NominalModel, pose: Array) -> Array:
    """What gravity asks of the joints at rest."""
    data = posed(model, machine, pose)
    return np.array([float(data.joint(name).qfrc_bias[0]) for name in machine.joints])


@pytest.mark.parametrize("arm", ARMS)
def test_a_flexible_link_is_the_link_it_was_while_it_does_not_bend(arm: str) -> None:
    machine = machine_of(arm)
    for effect in candidates(machine, ["link_flexibility"]):
        model = edited(effect, *effect.starts[0])
        assert model.body_subtreemass[0] == pytest.approx(machine.model.body_subtreemass[0])
        for pose in poses(machine):
            before, after = posed(machine.model, machine, pose), posed(model, machine, pose)
            assert np.allclose(after.subtree_com[0], before.subtree_com[0], atol=1e-9)
            whole = inertia(machine.model, before, machine)
            assert np.allclose(inertia(model, after, machine), whole, atol=1e-9 * whole.max())
            for k in range(machine.model.nsite):
                name = machine.model.site(k).name
                assert np.allclose(before.site(name).xpos, after.site(name).xpos, atol=1e-9)
            assert np.allclose(
                gravity(model, machine, pose), gravity(machine.model, machine, pose), atol=1e-8
            )


def test_a_link_bends_beyond_its_joint_by_moment_over_stiffness() -> None:
    machine = machine_of("planar")
    (effect,) = candidates(machine, ["link_flexibility"])[2:3]
    assert effect.where == "link3"
    stiffness = 250.0
    share = 0.4
    model = edited(effect, stiffness, 1.0, share)
    data = mujoco.MjData(model)
    body = model.site("tool").bodyid[0]
    assert model.body(body).name == "link3"
    for _ in range(6000):
        # A weight of 10 N at the tool, as an outer force.
        data.xfrc_applied[:] = 0.0
        lever = data.site("tool").xpos - data.xipos[body]
        force = np.array([0.0, -10.0, 0.0])
        data.xfrc_applied[body, :3], data.xfrc_applied[body, 3:] = force, np.cross(lever, force)
        mujoco.mj_step(model, data)
    bend = float(data.joint("link3_link_flexibility").qpos[0])
    pivot, angle = share * 0.3, float(data.qpos.sum())
    moment = (10.0 * (0.3 - pivot) + 9.81 * 2.0 * (0.15 - pivot)) * cos(angle)
    assert bend == pytest.approx(-moment / stiffness, rel=2e-3)


def test_bending_is_about_the_joint_or_across_it() -> None:
    machine = machine_of("spatial")
    about, across = (
        CATALOGUE["link_flexibility"](machine, "arm", variant) for variant in ("", "across")
    )
    axes = []
    for effect in (about, across):
        model = edited(effect, *effect.starts[0])
        axes.append(model.joint("arm_" + effect.kind + ("_across" if effect.variant else "")).axis)
    along = np.array([0.05, 0, 0.4]) / np.hypot(0.05, 0.4)
    assert np.allclose(axes[0], [0, 1, 0])
    assert np.allclose([axes[1] @ along, axes[1] @ axes[0]], 0, atol=1e-9)
    planar = CATALOGUE["link_flexibility"](machine_of("planar"), "link2")
    assert planar.variants_at(planar.machine, "link2") == ("",)


def test_the_centre_of_a_payload_lies_off_the_tool_in_the_frame_of_its_body() -> None:
    mass, centre = 0.4, np.array([0.03, -0.02, 0.05])
    for arm in ARMS:
        machine = machine_of(arm)
        effect = CATALOGUE["payload"](machine, "tool", "centre")
        at_tool, off = edited(effect, mass, 0.0, 0.0, 0.0), edited(effect, mass, *centre)
        place = off.body(off.nbody - 1)
        assert place.mass[0] == pytest.approx(mass)
        carrier = int(place.parentid[0])
        for pose in poses(machine):
            one, other = posed(at_tool, machine, pose), posed(off, machine, pose)
            turned = one.xmat[carrier].reshape(3, 3) @ centre
            assert other.xipos[-1] - one.xipos[-1] == pytest.approx(turned, abs=1e-12)
        plain = edited(CATALOGUE["payload"](machine, "tool"), mass)
        assert np.array_equal(plain.body_mass, at_tool.body_mass)
        assert np.array_equal(plain.body_ipos, at_tool.body_ipos)


def test_a_payload_weighs_at_the_tool() -> None:
    for arm in ("planar", "spatial"):
        machine = machine_of(arm)
        effect = CATALOGUE["payload"](machine, "tool")
        model = edited(effect, 0.7)
        for pose in poses(machine):
            data = posed(machine.model, machine, pose)
            jacobian = np.zeros((3, machine.model.nv))
            mujoco.mj_jacSite(machine.model, data, jacobian, None, machine.model.site("tool").id)
            added = -0.7 * machine.model.opt.gravity @ jacobian
            change = gravity(model, machine, pose) - gravity(machine.model, machine, pose)
            assert np.allclose(change, added, atol=1e-9)
            moved = inertia(model, posed(model, machine, pose), machine)
            extra = moved - inertia(machine.model, data, machine)
            assert np.allclose(extra, 0.7 * jacobian.T @ jacobian, atol=2e-3 * extra.max())


@pytest.mark.parametrize("arm", ARMS)
def test_mass_and_centre_of_a_link_change_its_weight(arm: str) -> None:
    machine = machine_of(arm)
    for effect in candidates(machine, ["link_mass", "link_com"]):
        body = machine.model.body(effect.where).id
        own = float(machine.model.body_mass[body])
        values = np.array(effect.starts[-1])
        model = edited(effect, *values)
        for pose in poses(machine, 2):
            data = posed(machine.model, machine, pose)
            jacobian = np.zeros((3, machine.model.nv))
            centre = np.array(data.xipos[body])
            mujoco.mj_jac(machine.model, data, jacobian, None, centre, body)
            if effect.kind == "link_mass":
                wanted = -values[0] * machine.model.opt.gravity @ jacobian
            else:
                shift = np.zeros(3)
                shift["xyz".index(effect.parameters[-1].name)] = values[-1]
                moved = np.zeros_like(jacobian)
                place = centre + data.xmat[body].reshape(3, 3) @ shift
                mujoco.mj_jac(machine.model, data, moved, None, place, body)
                wanted = -own * machine.model.opt.gravity @ (moved - jacobian)
            change = gravity(model, machine, pose) - gravity(machine.model, machine, pose)
            assert np.allclose(change, wanted, atol=1e-8), effect


def test_a_tilted_base_is_an_arm_turned_about_its_root() -> None:
    machine = machine_of("planar")
    effect = CATALOGUE["base_tilt"](machine, "base")
    assert [p.name for p in effect.parameters] == ["tilt_z"]
    model = edited(effect, 0.1)
    for pose in poses(machine):
        turned = pose + np.array([0.1, 0, 0])
        wanted = gravity(machine.model, machine, turned)
        assert np.allclose(gravity(model, machine, pose), wanted)
    spatial = CATALOGUE["base_tilt"](machine_of("spatial"), "base")
    assert [p.name for p in spatial.parameters] == ["tilt_x", "tilt_y"]
    tilted = edited(spatial, 0.1, 0.0)
    assert np.allclose(tilted.opt.gravity, 9.81 * np.array([0, -np.sin(0.1), -np.cos(0.1)]))


def pushed(model: mujoco.MjModel, name: str, force: float, steps: int = 3000) -> float:
    """Where an added slide comes to rest under a force along it, all else held."""
    for k in range(model.njnt):
        if model.joint(k).name != name:
            model.dof_damping[int(model.jnt_dofadr[k])] = 1e7
    model.dof_damping[int(model.joint(name).dofadr[0])] += 40.0
    model.opt.gravity[:] = 0.0
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION
    model.jnt_stiffness[:] = 0.0
    data = mujoco.MjData(model)
    data.qfrc_applied[int(model.joint(name).dofadr[0])] = force
    for _ in range(steps):
        mujoco.mj_step(model, data)
    return float(data.joint(name).qpos[0])


@pytest.mark.parametrize(("arm", "where"), [("planar", "link2"), ("spatial", "arm")])
def test_a_loose_link_slides_from_stop_to_stop_against_friction(arm: str, where: str) -> None:
    machine = machine_of(arm)
    effect = CATALOGUE["structural_looseness"](machine, where)
    direction = (0.7,) if arm == "planar" else (0.7, 0.4)
    gap, friction = 0.003, 2.0
    stiffness = effect.starts[0][-2]
    values = (*direction, gap, friction, stiffness, 0.2)
    name = f"{where}_structural_looseness"
    wanted = np.array(
        [cos(0.7), np.sin(0.7), 0]
        if arm == "planar"
        else [cos(0.4) * cos(0.7), cos(0.4) * np.sin(0.7), np.sin(0.4)]
    )
    model = edited(effect, *values)
    assert np.allclose(model.joint(name).axis, wanted)
    assert abs(pushed(model, name, 0.8 * friction)) < 2e-5
    ends = [pushed(edited(effect, *values), name, sign * (friction + 5.0)) for sign in (1, -1)]
    # The stiffness counts along the mean direction; elsewhere the contact mode is the same.
    assert ends[0] > gap / 2
    assert ends[1] < -gap / 2
    assert ends[0] - ends[1] == pytest.approx(gap + 2 * 5.0 / stiffness, rel=0.1)


def test_a_loose_link_turns_its_direction_with_its_own_joint() -> None:
    machine = machine_of("planar")
    effect = CATALOGUE["structural_looseness"](machine, "link2")
    model = edited(effect, 0.0, 0.01, 1.0, *effect.starts[0][-2:])
    data = mujoco.MjData(model)
    data.joint("joint1").qpos[0], data.joint("joint2").qpos[0] = 0.3, 0.5
    mujoco.mj_kinematics(model, data)
    before = np.array(data.site("tool").xpos)
    data.joint("link2_structural_looseness").qpos[0] = 0.004
    mujoco.mj_kinematics(model, data)
    moved = data.site("tool").xpos - before
    assert np.allclose(moved, 0.004 * np.array([cos(0.8), np.sin(0.8), 0]), atol=1e-12)


def test_effects_add_up_in_one_model() -> None:
    """Several edits, those that add joints among them, in either order."""
    machine = machine_of("spatial")
    several = [
        CATALOGUE["link_flexibility"](machine, "arm"),
        CATALOGUE["payload"](machine, "tool"),
        CATALOGUE["joint_compliance"](machine, "lift"),
        CATALOGUE["link_mass"](machine, "ram"),
        CATALOGUE["torque_ripple"](machine, "roll"),
        CATALOGUE["structural_looseness"](machine, "hand"),
        CATALOGUE["sensor_misalignment"](machine, "shake"),
    ]
    for order in (several, several[::-1]):
        spec = machine.fresh()
        for effect in order:
            effect.export(spec, np.array(effect.starts[0]))
        model = mujoco.MjModel.from_xml_string(spec.to_xml())
        assert [model.actuator(k).name for k in range(model.nu)] == list(machine.actuators)
        assert [model.sensor(k).name for k in range(model.nsensor)] == list(machine.sensors)
        data = mujoco.MjData(model)
        for _ in range(200):
            mujoco.mj_step(model, data)
        assert np.isfinite(data.qpos).all()
        mass = machine.model.body_subtreemass[0] + sum(
            effect.starts[0][0] for effect in order if effect.kind in ("payload", "link_mass")
        )
        assert model.body_subtreemass[0] == pytest.approx(mass, rel=1e-5)
