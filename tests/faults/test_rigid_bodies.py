"""Seats of every kind against rigid bodies; what is left of a fault as its gap shuts."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import mujoco
import numpy as np
import pytest

from loose_env.arms import Arm, LinearArm, planar
from loose_env.errors import InvalidSetting
from loose_env.faults import (
    Backlash,
    Fault,
    Healthy,
    RotationalLooseness,
    SeveralFaults,
    StructuralLooseness,
    part_seats,
    parts_of,
    seat_names,
    seated_spec,
    set_seat,
    twist_of,
)
from loose_env.typing import Array
from tests.faults.seats import (
    ARMS,
    apart,
    inertia_of,
    play,
    pose_of,
    records,
    rock,
    slide,
    tilted,
)


@cache
def arm_of(name: str) -> Arm:
    return ARMS[name]()


@pytest.fixture(params=ARMS)
def arm(request: pytest.FixtureRequest) -> Arm:
    return arm_of(request.param)


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


def seated(arm: Arm, fault: Fault, pose: Array) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The arm with a fault's seat and nothing else of a rig, at a pose."""
    links, kinds = part_seats(fault)
    spec = seated_spec(arm, links or arm.n, kinds)
    spec.option.timestep = arm.timestep
    model = spec.compile()
    set_seat(model, fault)
    data = mujoco.MjData(model)
    for name, q in zip(arm.joints, pose, strict=True):
        data.joint(name).qpos[0] = q
    return model, data


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


def extended(arm: Arm, pose: Array, fault: Fault) -> tuple[Array, Array]:
    """Inertia matrix and gravity force of the bare arm with seats added, from kinetic energy."""
    model, data, parts = arm.model, bare(arm, pose), parts_of(fault)
    loose, nv = [distal(arm, link) for link in part_seats(fault)[0]], arm.model.nv
    screws = [screw(arm, data, part) for part in parts]
    inertia = np.zeros((nv + len(parts), nv + len(parts)))
    force = np.zeros(nv + len(parts))
    for b in range(1, model.nbody):
        velocity, rate = np.zeros((2, 3, nv + len(parts)))
        linear, angular = np.zeros((2, 3, nv))
        mujoco.mj_jacBodyCom(model, data, linear, angular, b)
        velocity[:, :nv], rate[:, :nv] = linear, angular
        for k, (v, w, at) in enumerate(screws):
            if b in loose[k]:
                velocity[:, nv + k] = v + np.cross(w, data.xipos[b] - at)
                rate[:, nv + k] = w
        axes = data.ximat[b].reshape(3, 3)
        tensor = axes @ np.diag(model.body_inertia[b]) @ axes.T
        inertia += model.body_mass[b] * velocity.T @ velocity + rate.T @ tensor @ rate
        force += model.body_mass[b] * velocity.T @ model.opt.gravity
    inertia[:nv, :nv] += np.diag(model.dof_armature)
    return inertia, force


def faults_of(arm: Arm) -> list[Fault]:
    found: list[Fault] = []
    for link in range(1, arm.n + 1):
        found += [tilted(arm, link), play(link)]
    return [*found, SeveralFaults(faults=(tilted(arm, 1), play(2)))]


def test_a_rocking_link_turns_about_its_axis(arm: Arm) -> None:
    pose, angle = pose_of(arm), 0.3
    before = bare(arm, pose)
    for link in range(1, arm.n + 1):
        model, after = seated(arm, tilted(arm, link), pose)
        after.joint("seat").qpos[0] = angle
        mujoco.mj_kinematics(model, after)
        _, axis, at = screw(arm, before, tilted(arm, link))
        turned = rotation(axis, angle)
        moved = distal(arm, link)
        for b in range(1, arm.model.nbody):
            name = arm.model.body(b).name
            place, frame = before.xipos[b], before.ximat[b].reshape(3, 3)
            if b in moved:
                place, frame = at + turned @ (place - at), turned @ frame
            np.testing.assert_allclose(after.body(name).xipos, place, atol=1e-12)
            np.testing.assert_allclose(after.body(name).ximat.reshape(3, 3), frame, atol=1e-12)


def test_every_seat_moves_and_weighs_as_rigid_bodies_do(arm: Arm) -> None:
    pose, nv = pose_of(arm), arm.model.nv
    full = LinearArm(arm)
    at = full.at(pose)
    names = [arm.model.joint(j).name for j in range(arm.model.njnt)]
    flexible = [n for n in names if n not in arm.joints]
    in_bare = [int(arm.model.joint(n).dofadr[0]) for n in (*arm.joints, *flexible)]
    for fault in faults_of(arm):
        model, data = seated(arm, fault, pose)
        whole = (*names, *seat_names(model))
        inertia, force = extended(arm, pose, fault)
        scale = np.sqrt(np.diag(inertia))
        difference = inertia_of(model, data, whole) - inertia
        assert np.abs(difference / np.outer(scale, scale)).max() < 1e-9, fault
        # Let go in the middle of its gap, the arm falls as these bodies would.
        free = np.linalg.solve(inertia, force)
        fastest = max(np.abs(free).max(), 1.0)
        found = data.qacc[[int(model.joint(name).dofadr[0]) for name in whole]]
        np.testing.assert_allclose(found, free, atol=1e-5 * fastest, err_msg=str(fault))
        # The linear arm, in which every seat is open, knows the same of slides and of play.
        if not isinstance(fault, (StructuralLooseness, Backlash)):
            continue
        column = np.zeros(len(at.inertia))
        if isinstance(fault, Backlash):
            column[full.hinge_dofs[fault.joint - 1]] = 1.0
        else:
            slides = full.slide_dofs[fault.link - 1]
            column[slides] = twist_of(arm, fault)[: len(slides)]
        own, coupling, size = inertia[nv, nv], inertia[in_bare, nv], np.abs(inertia).max()
        np.testing.assert_allclose(column @ at.inertia @ column, own, rtol=1e-8, atol=1e-10)
        moving = at.inertia[[*full.joint_dofs, *full.flexible_dofs]] @ column
        np.testing.assert_allclose(moving, coupling, rtol=1e-8, atol=1e-10 * size)
        weight = np.abs(force).max() + 1e-9
        np.testing.assert_allclose(-at.load @ column, force[nv], atol=1e-9 * weight)


def test_stops_of_a_rotation_push_back_as_stated() -> None:
    arm = arm_of("six_axis")
    k, c, gap, depth, rate = (2e4, 5e4), (3.0, 7.0), 1e-3, 2e-5, 1e-3
    for link in (1, 4, 6):
        fault = replace(tilted(arm, link), gap=gap, stiffness=k, damping=c)
        for side, sign in ((0, -1.0), (1, 1.0)):
            model, data = seated(arm, fault, pose_of(arm))
            dof = int(model.joint("seat").dofadr[0])
            data.joint("seat").qpos[0] = sign * (gap / 2 + depth)
            data.joint("seat").qvel[0] = sign * rate
            mujoco.mj_forward(model, data)
            inertance = 1e-4 / model.tendon_invweight0[model.tendon("seat_high").id]
            law = k[side] * depth + c[side] * rate + inertance * sign * data.qacc[dof]
            assert -sign * data.qfrc_constraint[dof] == pytest.approx(law, rel=1e-3)


def stiff(arm: Arm, part: Any, factor: float, *, gap: float) -> Any:
    """Give a part of a seat stops with modes well inside the simulation step, and a gap."""
    inertia, _ = extended(arm, np.zeros(arm.n), part)
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
@pytest.mark.parametrize("make", ["slide", "play", "rotation"])
def test_as_its_gap_shuts_a_fault_fades_into_the_healthy_arm(arm: Arm, make: str) -> None:
    link = 1 + arm.n // 2
    kinds: dict[str, tuple[Any, float]] = {
        "slide": (slide(link), 2e-5),
        "play": (play(link), 5e-5),
        "rotation": (tilted(arm, link), 5e-5),
    }
    left, (part, gap) = [], kinds[make]
    for factor, finer in ((1.0, 1), (0.1, 4), (0.01, 10), (0.001, 32)):
        fault = stiff(arm, part, factor, gap=gap)
        found = [records(arm, [one], finer=finer)[0] for one in (fault, Healthy())]
        left.append(apart(*found))
    assert left[0] > 0.1
    assert (np.diff(left) < 0).all()
    assert left[-1] < 0.01


def test_stops_that_are_too_stiff_together_are_refused_with_what_would_do() -> None:
    # A slide across the first link and a rotation about the end of the next share the last mass.
    arm = planar(2)
    parts: list[Any] = [slide(1, direction=(0.0, 1.0, 0.0)), rock(2, pivot=(0.0, 0.0, 0.0))]
    inertia, _ = extended(arm, np.zeros(2), SeveralFaults(faults=tuple(parts)))
    mobility = np.linalg.inv(inertia)[-2:, -2:]
    each = [0.95 * (1.4 / arm.timestep) ** 2 / m for m in np.diag(mobility)]

    def both(share: float) -> SeveralFaults:
        held = [replace(p, stiffness=(share * k,) * 2) for p, k in zip(parts, each, strict=True)]
        return SeveralFaults(faults=tuple(held))

    with pytest.raises(InvalidSetting, match="too stiff together") as refusal:
        seated(arm, both(1.0), np.zeros(2))
    share = float(str(refusal.value).split("multiply all by less than ")[1].split(",")[0])
    seated(arm, both(0.99 * share), np.zeros(2))
