"""Seats loose in rotation, in several ways, and along a sliding joint, against rigid bodies."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from loose_env.arms import Arm, LinearArm, arm_from_file, planar, scara, six_axis, vera
from loose_env.errors import InvalidSetting
from loose_env.excitation import at_levels
from loose_env.faults import (
    Backlash,
    CompoundLooseness,
    Fault,
    Healthy,
    RotationalLooseness,
    StructuralLooseness,
    seat_names,
    seated_spec,
    seats_of,
    set_seat,
    twist_of,
)
from loose_env.rig import Job, SimulatedRig
from loose_env.sensors import SensorSuite
from loose_env.typing import Array
from scripts.thesis.rigs import cylindrical

UR5E = Path(__file__).parents[3] / "shared" / "models" / "ur5e_bare.xml"
NAMES = ["vera", "planar3", "six_axis", "scara", *(["ur5e"] if UR5E.exists() else [])]


@cache
def arm_of(name: str) -> Arm:
    if name == "ur5e":
        return arm_from_file(UR5E)
    made = {"vera": vera, "six_axis": six_axis, "scara": scara}
    return planar(3) if name == "planar3" else made[name]()


@pytest.fixture(params=NAMES)
def arm(request: pytest.FixtureRequest) -> Arm:
    return arm_of(request.param)


def rocking(arm: Arm, link: int, **changes: Any) -> RotationalLooseness:
    """A link that rocks about an axis through nothing in particular."""
    rng = np.random.default_rng(link)
    axis, pivot = rng.standard_normal(3), 0.1 * rng.standard_normal(3)
    if len(arm.axes) == 2:
        axis[:2] = 0.0
    settings = {"gap": 1e-3, "stiffness": (1e3, 1e3), "axis": tuple(axis), "pivot": tuple(pivot)}
    return RotationalLooseness(**{"link": link, **settings, **changes})


def sliding(arm: Arm, link: int, **changes: Any) -> StructuralLooseness:
    direction = np.random.default_rng(20 + link).standard_normal(3)
    if len(arm.axes) == 2:
        direction[2] = 0.0
    settings = {"gap": 1e-3, "stiffness": (1e4, 1e4), "direction": tuple(direction)}
    return StructuralLooseness(**{"link": link, **settings, **changes})


def pose_of(arm: Arm) -> Array:
    return arm.random_pose(np.random.default_rng(7))


def unit(v: Any) -> Array:
    return np.asarray(v, dtype=float) / np.linalg.norm(v)


def rotation(axis: Array, angle: float) -> Array:
    """Rodrigues' formula (3, 3)."""
    x, y, z = unit(axis)
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k)


def bare(arm: Arm, pose: Array) -> mujoco.MjData:
    data = mujoco.MjData(arm.model)
    data.qpos[arm.pose_addresses] = pose
    mujoco.mj_forward(arm.model, data)
    return data


def distal(arm: Arm, link: int) -> list[int]:
    """Bodies from a link outward."""
    model, found = arm.model, [arm.model.body(arm.seat_bodies[link - 1]).id]
    for b in range(found[0] + 1, model.nbody):
        if model.body_parentid[b] in found:
            found.append(b)
    return found


def screw(arm: Arm, data: mujoco.MjData, part: Fault) -> tuple[Array, Array, Array]:
    """Velocity of a point fixed in space, turning rate, and that point, for unit seat rate."""
    if isinstance(part, Backlash):
        joint = data.joint(arm.joints[part.joint - 1])
        if arm.sliding[part.joint - 1]:
            return joint.xaxis.copy(), np.zeros(3), joint.xanchor.copy()
        return np.zeros(3), joint.xaxis.copy(), joint.xanchor.copy()
    assert isinstance(part, (RotationalLooseness, StructuralLooseness))
    frame = data.body(arm.seat_bodies[part.link - 1])
    turn = frame.xmat.reshape(3, 3)
    if isinstance(part, StructuralLooseness):
        return turn @ unit(part.direction), np.zeros(3), frame.xpos.copy()
    return np.zeros(3), turn @ unit(part.axis), frame.xpos + turn @ np.array(part.pivot)


def extended(arm: Arm, pose: Array, parts: list[Fault], link: int) -> tuple[Array, Array]:
    """Inertia matrix and gravity force of the bare arm with seats added, from kinetic energy."""
    model, data = arm.model, bare(arm, pose)
    loose, nv = distal(arm, link), arm.model.nv
    screws = [screw(arm, data, part) for part in parts]
    inertia = np.zeros((nv + len(parts), nv + len(parts)))
    force = np.zeros(nv + len(parts))
    for b in range(1, model.nbody):
        linear, angular = np.zeros((3, nv)), np.zeros((3, nv))
        mujoco.mj_jacBodyCom(model, data, linear, angular, b)
        velocity = np.zeros((3, nv + len(parts)))
        rate = np.zeros((3, nv + len(parts)))
        velocity[:, :nv], rate[:, :nv] = linear, angular
        if b in loose:
            for k, (v, w, at) in enumerate(screws):
                velocity[:, nv + k] = v + np.cross(w, data.xipos[b] - at)
                rate[:, nv + k] = w
        axes = data.ximat[b].reshape(3, 3)
        tensor = axes @ np.diag(model.body_inertia[b]) @ axes.T
        inertia += model.body_mass[b] * velocity.T @ velocity + rate.T @ tensor @ rate
        force += model.body_mass[b] * velocity.T @ model.opt.gravity
    inertia[:nv, :nv] += np.diag(model.dof_armature)
    return inertia, force


def seated(arm: Arm, fault: Fault) -> mujoco.MjModel:
    link, kinds = seats_of(fault)
    spec = seated_spec(arm, arm.n if link is None else link, kinds)
    spec.option.timestep = arm.timestep
    model = spec.compile()
    set_seat(model, fault)
    return model


def order(arm: Arm, model: mujoco.MjModel) -> Array:
    """Degrees of freedom in the order of `extended`."""
    names = [arm.model.joint(j).name for j in range(arm.model.njnt)]
    return np.array([int(model.joint(n).dofadr[0]) for n in (*names, *seat_names(model))])


def at_pose(arm: Arm, model: mujoco.MjModel, pose: Array) -> mujoco.MjData:
    data = mujoco.MjData(model)
    for name, q in zip(arm.joints, pose, strict=True):
        data.joint(name).qpos[0] = q
    return data


def box(arm: Arm, link: int, count: int) -> CompoundLooseness:
    """A link loose in several ways: slide, rotation, slide, ..."""
    planar_arm = len(arm.axes) == 2
    slides = (
        np.eye(3)[:2] if planar_arm else np.linalg.qr(np.random.default_rng(3).random((3, 3)))[0]
    )
    parts: list[StructuralLooseness | RotationalLooseness] = []
    for k in range(count):
        if k % 2 == 1:
            axis = np.eye(3)[2] if planar_arm else slides[k // 2]
            parts.append(rocking(arm, link, axis=tuple(axis)))
        else:
            parts.append(sliding(arm, link, direction=tuple(slides[k // 2])))
    return CompoundLooseness(link=link, parts=tuple(parts))


def faults_of(arm: Arm) -> list[Fault]:
    found: list[Fault] = []
    for link in range(1, arm.n + 1):
        found += [rocking(arm, link), box(arm, link, 2), box(arm, link, 3)]
        found.append(Backlash(joint=link, gap=1e-3, stiffness=(1e3, 1e3)))
        if len(arm.axes) == 3:
            found.append(box(arm, link, 6))
    return found


def parts_list(fault: Fault) -> list[Fault]:
    return list(fault.parts) if isinstance(fault, CompoundLooseness) else [fault]


def test_a_rocking_link_turns_about_its_axis(arm: Arm) -> None:
    pose, angle = pose_of(arm), 0.3
    before = bare(arm, pose)
    for link in range(1, arm.n + 1):
        fault = rocking(arm, link)
        model = seated(arm, fault)
        after = at_pose(arm, model, pose)
        after.joint("seat").qpos[0] = angle
        mujoco.mj_kinematics(model, after)
        _, axis, at = screw(arm, before, fault)
        turned = rotation(axis, angle)
        moved = distal(arm, link)
        for b in range(1, arm.model.nbody):
            name = arm.model.body(b).name
            place, frame = before.xipos[b], before.ximat[b].reshape(3, 3)
            if b in moved:
                place, frame = at + turned @ (place - at), turned @ frame
            np.testing.assert_allclose(after.body(name).xipos, place, atol=1e-12)
            np.testing.assert_allclose(after.body(name).ximat.reshape(3, 3), frame, atol=1e-12)


def test_parts_of_a_compound_seat_move_from_the_flange_outward() -> None:
    arm, link = arm_of("six_axis"), 3
    fault, pose, travel = box(arm, link, 2), pose_of(arm), (0.02, 0.3)
    model = seated(arm, fault)
    after = at_pose(arm, model, pose)
    for name, q in zip(seat_names(model), travel, strict=True):
        after.joint(name).qpos[0] = q
    mujoco.mj_kinematics(model, after)
    before = bare(arm, pose)
    slide, _, _ = screw(arm, before, fault.parts[0])
    _, axis, at = screw(arm, before, fault.parts[1])
    place = at + rotation(axis, travel[1]) @ (before.site(arm.tool).xpos - at)
    np.testing.assert_allclose(after.site(arm.tool).xpos, place + travel[0] * slide, atol=1e-12)


def test_every_seat_moves_and_weighs_as_rigid_bodies_do(arm: Arm) -> None:
    pose = pose_of(arm)
    for fault in faults_of(arm):
        link, _ = seats_of(fault)
        assert link is not None
        model = seated(arm, fault)
        data = at_pose(arm, model, pose)
        mujoco.mj_forward(model, data)
        dofs = order(arm, model)
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, full)
        inertia, force = extended(arm, pose, parts_list(fault), link)
        scale = np.sqrt(np.diag(inertia))
        difference = (full[np.ix_(dofs, dofs)] - inertia) / np.outer(scale, scale)
        assert np.abs(difference).max() < 1e-9, fault
        # Let go in the middle of its gap, the arm falls as these bodies would.
        free = np.linalg.solve(inertia, force)
        fastest = max(np.abs(free).max(), 1.0)
        np.testing.assert_allclose(data.qacc[dofs], free, atol=1e-5 * fastest, err_msg=str(fault))


def test_stops_of_a_rotation_push_back_as_stated() -> None:
    arm = arm_of("six_axis")
    pose, k, c, gap = pose_of(arm), (2e4, 5e4), (3.0, 7.0), 1e-3
    for link in (1, 4, 6):
        fault = rocking(arm, link, gap=gap, stiffness=k, damping=c)
        model = seated(arm, fault)
        dof = int(model.joint("seat").dofadr[0])
        for side, sign in ((0, -1.0), (1, 1.0)):
            data = at_pose(arm, model, pose)
            depth, rate = 2e-5, 1e-3
            data.joint("seat").qpos[0] = sign * (gap / 2 + depth)
            data.joint("seat").qvel[0] = sign * rate
            mujoco.mj_forward(model, data)
            inertance = 1e-4 / model.tendon_invweight0[model.tendon("seat_high").id]
            law = k[side] * depth + c[side] * rate + inertance * sign * data.qacc[dof]
            assert -sign * data.qfrc_constraint[dof] == pytest.approx(law, rel=1e-3)


def test_twists_and_linear_seats_are_those_of_rigid_bodies(arm: Arm) -> None:
    full, plain = LinearArm(arm, rotations=True), LinearArm(arm)
    pose = pose_of(arm)
    at, without = full.at(pose), plain.at(pose)
    moving = [*full.joint_dofs, *full.flexible_dofs]
    in_bare = [*range(arm.model.nv)]
    names = [arm.model.joint(j).name for j in range(arm.model.njnt)]
    flexible = [n for n in names if n not in arm.joints]
    in_bare = [int(arm.model.joint(n).dofadr[0]) for n in (*arm.joints, *flexible)]
    for fault in faults_of(arm):
        link, _ = seats_of(fault)
        assert link is not None
        parts = parts_list(fault)
        columns = np.zeros((len(at.inertia), len(parts)))
        columns[full.twist_dofs[link - 1]] = np.transpose([twist_of(arm, p) for p in parts])
        inertia, force = extended(arm, pose, parts, link)
        seats = slice(arm.model.nv, None)
        np.testing.assert_allclose(
            columns.T @ at.inertia @ columns, inertia[seats, seats], rtol=1e-8, atol=1e-10
        )
        coupling = inertia[in_bare, seats]
        size = np.abs(inertia).max()
        np.testing.assert_allclose(
            at.inertia[moving] @ columns, coupling, rtol=1e-8, atol=1e-10 * size
        )
        weight = np.abs(force).max() + 1e-9
        np.testing.assert_allclose(-at.load @ columns, force[seats], atol=1e-9 * weight)
        if isinstance(fault, Backlash):
            play = plain.hinge_dofs[fault.joint - 1]
            own = without.inertia[[*plain.joint_dofs, *plain.flexible_dofs], play]
            np.testing.assert_allclose(own, coupling[:, 0], rtol=1e-8, atol=1e-10 * size)


def record(
    arm: Arm,
    fault: Fault,
    *,
    finer: int = 1,
    level: float | None = None,
    joint: int | None = None,
    centred: bool = False,
) -> Array:
    """Tool acceleration with ideal sensors (d, N); the same excitation every time.

    All joints are shaken if none is named; a centred seat starts in the middle of its gap.
    """
    rig = SimulatedRig(arm, sensors=SensorSuite.ideal(), timestep=arm.timestep / finer, threads=1)
    rig.mount(0, fault)
    if centred:
        rig.plants[0].gaps[:] = 0.0
    pose = pose_of(arm)
    shaken = np.ones(arm.n) if joint is None else np.arange(arm.n) == joint
    levels = (arm.levels[-1] if level is None else level) * shaken
    shake, _ = at_levels(rig.nominal.at(pose), levels, duration=0.2)
    job = Job(slot=0, pose=pose, excitation=shake, rng=np.random.default_rng(5))
    found = rig.measure_many([job])[0]
    assert found.failure is None
    return found.tool


def apart(one: Array, other: Array) -> float:
    """Relative difference of two records without their means."""
    one, other = (x - x.mean(axis=1, keepdims=True) for x in (one, other))
    return float(np.linalg.norm(one - other) / np.linalg.norm(other))


def stiff(arm: Arm, part: Any, factor: float, *, gap: float) -> Any:
    """Give a part of a seat stops with modes well inside the simulation step, and a gap."""
    inertia, _ = extended(arm, np.zeros(arm.n), [part], part.link)
    effective = 1 / np.linalg.inv(inertia)[-1, -1]
    k = float(effective * (0.3 / arm.timestep) ** 2)
    c = float(0.3 * np.sqrt(k * effective))
    return replace(
        part,
        gap=gap * factor,
        stiffness=(k / factor, k / factor),
        damping=(c / np.sqrt(factor), c / np.sqrt(factor)),
    )


@pytest.mark.slow
@pytest.mark.parametrize("make", ["rotation", "compound"])
def test_as_its_gaps_shut_a_further_seat_fades_into_the_healthy_arm(arm: Arm, make: str) -> None:
    link = 1 + arm.n // 2
    parts: tuple[Any, ...] = (rocking(arm, link),)
    gaps = [5e-5]
    if make == "compound":
        parts, gaps = box(arm, link, 2).parts, [2e-5, 5e-5]
    left = []
    for factor, finer in ((1.0, 1), (0.1, 4), (0.01, 10), (0.001, 32)):
        closed = [stiff(arm, p, factor, gap=g) for p, g in zip(parts, gaps, strict=True)]
        fault: Fault = closed[0]
        if make == "compound":
            fault = CompoundLooseness(link=link, parts=tuple(closed))
        healthy = record(arm, Healthy(), finer=finer)
        left.append(apart(record(arm, fault, finer=finer), healthy))
    assert left[0] > 0.1
    assert (np.diff(left) < 0).all()
    assert left[-1] < 0.01


def weightless(arm: Arm) -> Arm:
    """The arm without gravity: what is loose floats, and strikes nothing in a wide gap."""
    spec = arm.spec.copy()
    spec.option.gravity = [0, 0, 0]
    return replace(arm, spec=spec)


@pytest.mark.parametrize("stuck", [0, 1])
@pytest.mark.parametrize("how", ["friction", "no gap"])
def test_a_compound_seat_with_one_part_shut_is_the_other_part(
    arm: Arm, stuck: int, how: str
) -> None:
    arm, link = weightless(arm), 1 + arm.n // 2
    parts: list[Any] = [stiff(arm, p, 1.0, gap=0.05) for p in box(arm, link, 2).parts]
    open_both = CompoundLooseness(link=link, parts=tuple(parts))
    single = parts[1 - stuck]
    if how == "friction":
        parts[stuck] = replace(parts[stuck], friction=1e6)
    else:
        parts[stuck] = stiff(arm, parts[stuck], 0.01, gap=0.0)
    shut_one = CompoundLooseness(link=link, parts=tuple(parts))
    lone, joint, both, healthy = (
        record(arm, fault, finer=1 if how == "friction" else 10, centred=True)
        for fault in (single, shut_one, open_both, Healthy())
    )
    assert apart(joint, lone) < 0.01
    for other in (both, healthy):
        assert apart(other, lone) > 0.05


@pytest.mark.parametrize(("name", "joints"), [("scara", [3]), ("cylindrical", [2, 3])])
def test_play_of_a_sliding_joint_is_along_it(name: str, joints: list[int]) -> None:
    arm = cylindrical() if name == "cylindrical" else arm_of(name)
    pose = pose_of(arm)
    linear = LinearArm(arm).at(pose)
    for joint in joints:
        play = Backlash(joint=joint, gap=2e-4, stiffness=(1e4, 1e4))
        model = seated(arm, play)
        assert model.joint("seat").type[0] == mujoco.mjtJoint.mjJNT_SLIDE
        data = at_pose(arm, model, pose)
        mujoco.mj_kinematics(model, data)
        before = data.site(arm.tool).xpos.copy()
        data.joint("seat").qpos[0] = 0.01
        mujoco.mj_kinematics(model, data)
        along = data.joint(arm.joints[joint - 1]).xaxis
        np.testing.assert_allclose(data.site(arm.tool).xpos - before, 0.01 * along, atol=1e-12)
        # The tool moves with the play as with the joint.
        column = linear.jacobian[:, linear.linear.hinge_dofs[joint - 1]]
        np.testing.assert_allclose(column, linear.kinematic[:, joint - 1], atol=1e-12)


def test_stops_that_are_too_stiff_together_are_refused_with_what_would_do() -> None:
    # A slide across the link and a rotation about its end share the link's mass.
    arm = planar(2)
    parts = [sliding(arm, 2, direction=(0.0, 1.0, 0.0)), rocking(arm, 2, pivot=(0.0, 0.0, 0.0))]
    inertia, _ = extended(arm, np.zeros(2), list(parts), 2)
    mobility = np.linalg.inv(inertia)[-2:, -2:]
    each = [0.95 * (1.4 / arm.timestep) ** 2 / m for m in np.diag(mobility)]
    parts = [replace(p, stiffness=(k, k)) for p, k in zip(parts, each, strict=True)]
    fault = CompoundLooseness(link=2, parts=tuple(parts))
    with pytest.raises(InvalidSetting, match="too stiff together") as refusal:
        seated(arm, fault)
    share = float(str(refusal.value).split("multiply all by less than ")[1].split(",")[0])
    softer = [
        replace(p, stiffness=(0.99 * share * k,) * 2) for p, k in zip(parts, each, strict=True)
    ]
    seated(arm, CompoundLooseness(link=2, parts=tuple(softer)))
