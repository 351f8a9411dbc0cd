"""Serial chain found in a compiled model file, and a MuJoCo spec rebuilt from it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from loose_env.arms.arm import quat_of
from loose_env.arms.holding import MOTOR_SIDE, new_spec, principal
from loose_env.arms.model_file import ModelFile
from loose_env.errors import InvalidData, InvalidSetting, UnknownName
from loose_env.typing import Array

_FREE, _BALL = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_BALL)
_FINGERS = 2
"""Tails of equal depth and at most this many joints are fingers of one gripper [joints]."""


@dataclass(frozen=True, kw_only=True)
class Chain:
    """A serial chain in a compiled file, by ids of its model, base first."""

    joints: tuple[int, ...]
    """Driven joints."""
    links: tuple[int, ...]
    """Body that each joint moves."""
    springs: tuple[int, ...]
    """Elastic joints between the base and the tool: they have a spring and no drive."""
    tool_body: int
    tool_site: int | None
    """Site of the tool; None where the body's own frame is the tool."""
    tool_origin: str
    """Origin of the tool, in words."""
    owner: tuple[int, ...]
    """For each body of the model: the link it rides on, from 1; 0 where it stands on the
    ground."""
    warnings: tuple[str, ...]


def find_chain(file: ModelFile, tool: str | None, joints: Sequence[str] | None) -> Chain:
    """Find the chain from the base to the tool.

    Raises
    ------
    UnknownName
        If there is no such tool or joint.
    InvalidData
        If there is no serial chain of hinges and slides on a fixed base.
    """
    m, where = file.model, file.path.name
    warnings: list[str] = []
    site, body, origin = _given_tool(file, tool)
    if body is None:
        leaf, body = _deepest(file)
        warnings += leaf
    path = _joints_to(m, body)
    _refuse_unlike(file, path)
    every = path
    if joints is not None and path:
        path = _chosen(file, path, joints)
    springs, play = _undriven(file, every, [] if joints is None else path)
    path = [j for j in path if j not in springs and j not in play]
    warnings += [
        f"joint {m.joint(j).name} has play and no drive: it is taken as fixed, as in a healthy arm"
        for j in play
    ]
    if not path:
        which = f"no joint moves the tool {tool!r}" if tool else "there is no hinge or slide"
        raise InvalidData(f"{where}: {which}; an arm needs at least one joint")
    links = tuple(int(m.jnt_bodyid[j]) for j in path)
    for first, second, link in zip(path, path[1:], links[1:], strict=False):
        if m.jnt_bodyid[first] == link:
            raise InvalidData(
                f"{where}: body {m.body(link).name!r} has two joints, {m.joint(first).name!r} and "
                f"{m.joint(second).name!r}, and no link lies between them; put a body with mass "
                "between them, or leave one out with joints=[...]"
            )
    owner = _owners(m, links)
    if tool is None and site is None:
        site, body, origin = _default_tool(m, links[-1], owner)
    _refuse_loops(file, path, owner, warnings)
    dropped = [
        m.joint(j).name for j in range(m.njnt) if owner[m.jnt_bodyid[j]] == 0 and j not in springs
    ]
    if dropped:
        warnings.append(f"joints that do not move the arm are left out: {', '.join(dropped)}")
    return Chain(
        joints=tuple(path),
        links=links,
        springs=springs,
        tool_body=body,
        tool_site=site,
        tool_origin=origin,
        owner=owner,
        warnings=tuple(warnings),
    )


def _names(elements: Sequence[str]) -> str:
    return ", ".join(repr(e) for e in elements) or "none"


def _given_tool(file: ModelFile, tool: str | None) -> tuple[int | None, int | None, str]:
    m = file.model
    sites = [m.site(i).name for i in range(m.nsite)]
    bodies = [m.body(i).name for i in range(1, m.nbody)]
    if tool is None:
        if "tool" not in sites:
            return None, None, ""
        i = sites.index("tool")
        return i, int(m.site_bodyid[i]), "the file's site 'tool'"
    if tool in sites:
        i = sites.index(tool)
        return i, int(m.site_bodyid[i]), "the site asked for"
    if tool in bodies:
        return None, bodies.index(tool) + 1, "the frame of the body asked for"
    raise UnknownName(
        f"{file.path.name}: there is no site or body {tool!r} for the tool; sites: "
        f"{_names(sites)}; bodies: {_names(bodies)}"
    )


def _default_tool(
    m: mujoco.MjModel, last: int, owner: Sequence[int]
) -> tuple[int | None, int, str]:
    own = [i for i in range(m.nsite) if m.site_bodyid[i] == last]
    if own:
        return own[-1], last, f"last site of the last body {m.body(last).name!r}"
    # Bodies without a joint between them and the last one are part of it.
    fixed = [i for i in range(m.nsite) if m.body_weldid[m.site_bodyid[i]] == last]
    if fixed:
        body = int(m.site_bodyid[fixed[-1]])
        return fixed[-1], body, f"last site of {m.body(body).name!r}, fixed to the last body"
    return None, last, f"frame of the last body {m.body(last).name!r}, which has no site"


def _joints_to(m: mujoco.MjModel, body: int) -> list[int]:
    """Joints between the world and a body, base first."""
    path: list[int] = []
    while body:
        first, count = int(m.body_jntadr[body]), int(m.body_jntnum[body])
        path = [*range(first, first + count), *path]
        body = int(m.body_parentid[body])
    return path


def _deepest(file: ModelFile) -> tuple[list[str], int]:
    """Last body of the deepest chain; where fingers end it, the body that carries them."""
    m = file.model
    if not m.njnt:
        raise InvalidData(f"{file.path.name}: there is no joint at all; an arm needs one or more")

    def depth(path: list[int]) -> int:
        return sum(int(m.jnt_type[j]) not in (_FREE, _BALL) for j in path)

    bodies = [int(b) for b in range(1, m.nbody) if m.body_jntnum[b]]
    paths = {b: _joints_to(m, b) for b in bodies}
    most = max(depth(p) for p in paths.values())
    ends = [b for b in bodies if depth(paths[b]) == most]
    if most == 0:
        _refuse_unlike(file, paths[ends[0]])
    if len(ends) == 1:
        return [], ends[0]
    common = [
        j for k, j in enumerate(paths[ends[0]]) if all(paths[b][k : k + 1] == [j] for b in ends)
    ]
    if not common or most - depth(common) > _FINGERS:
        raise InvalidData(
            f"{file.path.name}: several chains of {most} joints, ending in bodies "
            f"{_names([m.body(b).name for b in ends])}; name the tool's site or body: tool=..."
        )
    last = int(m.jnt_bodyid[common[-1]])
    fingers = _names([m.body(b).name for b in ends])
    return [f"chains of equal depth end in {fingers}: taken as fingers of a gripper"], last


def _refuse_unlike(file: ModelFile, path: Sequence[int]) -> None:
    m = file.model
    for j in path:
        joint, body = m.joint(j).name, m.body(int(m.jnt_bodyid[j])).name
        if m.jnt_type[j] == _FREE:
            raise InvalidData(
                f"{file.path.name}: body {body!r} floats on the free joint {joint!r}; an arm "
                "stands on the ground: remove the free joint"
            )
        if m.jnt_type[j] == _BALL:
            raise InvalidData(
                f"{file.path.name}: joint {joint!r} of body {body!r} is a ball joint; an arm "
                "under test has hinges and slides, one drive each"
            )


def _chosen(file: ModelFile, path: list[int], joints: Sequence[str]) -> list[int]:
    m = file.model
    names = [m.joint(j).name for j in path]
    asked = [joints] if isinstance(joints, str) else joints
    if not isinstance(asked, Iterable):
        raise InvalidSetting(f"joints are a list of names, got {joints!r}; from {_names(names)}")
    asked = list(asked)
    if not asked:
        raise InvalidData(
            f"{file.path.name}: joints names none and an arm needs at least one joint; from base "
            f"to tool: {_names(names)}"
        )
    unknown = [j for j in asked if j not in names]
    if unknown:
        every = [m.joint(j).name for j in range(m.njnt)]
        off = [j for j in unknown if j in every]
        reason = f"joints {_names(off)} do not move the tool" if off else "there are no such joints"
        raise UnknownName(
            f"{file.path.name}: {reason} (asked for {_names(unknown)}); from base to tool: "
            f"{_names(names)}"
        )
    if len(set(asked)) != len(asked):
        raise UnknownName(f"{file.path.name}: joints are named twice in {_names(asked)}")
    return [j for j, name in zip(path, names, strict=True) if name in asked]


def _undriven(
    file: ModelFile, path: Sequence[int], asked: Sequence[int]
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Joints of a path that are elastic, and those that have play; none that is asked for.

    An elastic joint has a spring and no drive, in a file that gives drives to others. In a file
    that gives none, it is one behind another joint of its body on the same axis: an elastic
    drive, and no joint of its own. Play is a joint with stops, and neither drive nor spring, on the
    body of a driven one.
    """
    m = file.model
    drives = {drive.joint for drive in file.drives}
    driven = [j for j in path if m.joint(j).name in drives or m.jnt_actfrclimited[j]]
    moved = {int(m.jnt_bodyid[j]) for j in driven}
    others = [k for k, j in enumerate(path) if j not in driven and j not in asked]
    springs = tuple(
        path[k]
        for k in others
        if m.jnt_stiffness[path[k]] > 0
        and (driven or (k > 0 and _on_one_axis(m, path[k - 1], path[k])))
    )
    play = tuple(
        path[k]
        for k in others
        if m.jnt_stiffness[path[k]] == 0
        and m.jnt_limited[path[k]]
        and int(m.jnt_bodyid[path[k]]) in moved
    )
    return springs, play


def _on_one_axis(m: mujoco.MjModel, first: int, second: int) -> bool:
    return bool(
        m.jnt_bodyid[first] == m.jnt_bodyid[second]
        and m.jnt_type[first] == m.jnt_type[second]
        and abs(m.jnt_axis[first] @ m.jnt_axis[second]) > 1 - 1e-9
        and np.linalg.norm(np.cross(m.jnt_axis[first], m.jnt_pos[second] - m.jnt_pos[first])) < 1e-9
    )


def _owners(m: mujoco.MjModel, links: Sequence[int]) -> tuple[int, ...]:
    owner = [0] * m.nbody
    for body in range(1, m.nbody):  # a parent comes before its children
        own = links.index(body) + 1 if body in links else 0
        owner[body] = own or owner[int(m.body_parentid[body])]
    return tuple(owner)


def _refuse_loops(
    file: ModelFile, path: Sequence[int], owner: Sequence[int], warnings: list[str]
) -> None:
    m = file.model
    driven = {m.joint(j).name for j in path}
    for tie in file.ties:
        if tie.kind == "bodies":
            ends = [owner[m.body(n).id] if n else 0 for n in tie.names]
            loose = [
                n for n in tie.names if n and any(m.jnt_type[j] == _FREE for j in _above(m, n))
            ]
            if ends[0] != ends[1] and not loose:
                names = " and ".join(repr(n or "world") for n in tie.names)
                raise InvalidData(
                    f"{file.path.name}: an equality constraint ties bodies {names} and closes a "
                    "loop; the arm has to be one serial chain: remove the constraint"
                )
        elif driven >= set(tie.names) and all(tie.names):
            raise InvalidData(
                f"{file.path.name}: joints {tie.names[0]!r} and {tie.names[1]!r} are coupled by an "
                "equality constraint, or one mimics the other; each joint of an arm has its own "
                "drive: remove the coupling, or leave one joint out with joints=[...]"
            )
        elif driven & set(tie.names):
            names = " and ".join(repr(n) for n in tie.names if n)
            warnings.append(f"the equality constraint on joint {names} is left out")


def _above(m: mujoco.MjModel, body: str) -> list[int]:
    return _joints_to(m, int(m.body(body).id))


BARE_MOTOR_SIDE = 0.25
"""The same where the file gives the joint no rotor inertia: the flange stands for the rotor too."""
TOOL_SITE = "tool"
_RESERVED = ("seat", "open_", "shaker", "coil")  # joints that a rig adds begin with these


def chain_spec(
    file: ModelFile, chain: Chain, tool_offset: Array
) -> tuple[mujoco.MjSpec, list[str], list[str], tuple[str, ...]]:
    """Build the chain anew, in radians: spec, driven joints, their links and elastic joints.

    Each link is everything of the file that rides on it, other joints frozen where the file
    has them at its reference. Flange and link share its mass and inertia, both about the same
    centre and in the same frame, so that together they are the link of the file to rounding;
    the flange has `MOTOR_SIDE` of it, or `BARE_MOTOR_SIDE` where the joint has no rotor. Joints
    keep their zero, stiffness, damping and rotor inertia; their stops, dry friction and gravity
    compensation are left out.

    An elastic joint on the body of a driven one stays with it on the flange: the drive's spring
    lies before the seat. One on a body of its own bends the link that it is part of, behind the
    seat; the body is kept.

    The tool is moved by ``tool_offset`` (3,) in its own frame [m].
    """
    m = file.model
    data = mujoco.MjData(m)
    mujoco.mj_kinematics(m, data)
    mujoco.mj_comPos(m, data)
    off = m.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY
    spec = new_spec(gravity=(0.0, 0.0, 0.0) if off else [float(g) for g in m.opt.gravity])
    parent, base = spec.worldbody, 0
    joints: list[str] = []
    links: list[str] = []
    springs: list[str] = []
    taken = {m.body(b).name for b in range(m.nbody)}
    moving = sorted({int(m.jnt_bodyid[j]) for j in (*chain.joints, *chain.springs)})
    rides = _riding(m, moving)
    for body in moving:  # a parent comes before its children
        name = m.body(body).name
        own = [j for j in sorted((*chain.joints, *chain.springs)) if m.jnt_bodyid[j] == body]
        place, turn = _relative(data, base, data.xpos[body], data.xmat[body])
        for j in reversed(own):
            place, turn = _to_zero(m, j, place, turn)
        lumped = _lumped(m, data, [b for b in range(m.nbody) if rides[b] == body], body)
        driven = body in chain.links
        moved_name = name
        if driven:
            moved_name = f"{name}_flange"
            while moved_name in taken:
                moved_name += "_"
        flange = parent.add_body(name=moved_name, pos=list(place), quat=quat_of(turn))
        for j in own:
            joint = m.joint(j).name
            joint = f"file_{joint}" if joint.startswith(_RESERVED) else joint
            _add_joint(file, j, flange, joint)
            (joints if j in chain.joints else springs).append(joint)
        distal = flange
        if driven:
            rotor = max(joint.armature for joint in flange.joints)
            motor_side = MOTOR_SIDE if rotor > 0 else BARE_MOTOR_SIDE
            distal = flange.add_body(name=name)
            links.append(name)
            _give(flange, lumped, motor_side)
            _give(distal, lumped, 1 - motor_side)
        else:
            _give(flange, lumped, 1.0)
        parent, base = distal, body
    if chain.tool_site is None:
        place, turn = _relative(data, base, data.xpos[chain.tool_body], data.xmat[chain.tool_body])
    else:
        site = chain.tool_site
        place, turn = _relative(data, base, data.site_xpos[site], data.site_xmat[site])
    place = place + turn @ tool_offset
    parent.add_site(name=TOOL_SITE, pos=list(place), quat=quat_of(turn))
    return spec, joints, links, tuple(springs)


def _riding(m: mujoco.MjModel, moving: list[int]) -> list[int]:
    """For each body the one of the chain that it rides on; 0 where it stands on the ground."""
    rides = [0] * m.nbody
    for body in range(1, m.nbody):
        rides[body] = body if body in moving else rides[int(m.body_parentid[body])]
    return rides


def _give(part: mujoco.MjsBody, lumped: tuple[float, Array, Array, Array], share: float) -> None:
    """Give a body a share of a mass, with its centre, axes and moments."""
    mass, centre, axes, moments = lumped
    part.mass, part.ipos, part.iquat = share * mass, list(centre), quat_of(axes)
    part.inertia = [share * float(x) for x in moments]
    part.explicitinertial = True


def _add_joint(file: ModelFile, j: int, flange: mujoco.MjsBody, name: str) -> None:
    m = file.model
    dof = int(m.jnt_dofadr[j])
    drives = [d for d in file.drives if d.joint == m.joint(j).name]
    flange.add_joint(
        name=name,
        type=mujoco.mjtJoint(int(m.jnt_type[j])),
        axis=list(m.jnt_axis[j]),
        pos=list(m.jnt_pos[j]),
        armature=float(m.dof_armature[dof]) + sum(d.armature for d in drives),
        damping=[float(m.dof_damping[dof]) + sum(d.damping for d in drives), 0, 0],
        stiffness=[float(m.jnt_stiffness[j]), 0, 0],
    )


def _relative(data: mujoco.MjData, base: int, place: Array, turn: Array) -> tuple[Array, Array]:
    """A world frame as seen from a body: position (3,) and rotation (3, 3)."""
    back = data.xmat[base].reshape(3, 3).T
    return back @ (place - data.xpos[base]), back @ turn.reshape(3, 3)


def _to_zero(m: mujoco.MjModel, j: int, place: Array, turn: Array) -> tuple[Array, Array]:
    """Move a body's frame from its joint's reference to the joint's zero."""
    reference = float(m.qpos0[int(m.jnt_qposadr[j])])
    axis, anchor = m.jnt_axis[j], m.jnt_pos[j]
    if m.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE:
        return place - turn @ axis * reference, turn
    quat, back = np.zeros(4), np.zeros(9)
    mujoco.mju_axisAngle2Quat(quat, axis, -reference)
    mujoco.mju_quat2Mat(back, quat)
    rotation = back.reshape(3, 3)
    return place + turn @ (anchor - rotation @ anchor), turn @ rotation


def _lumped(
    m: mujoco.MjModel, data: mujoco.MjData, bodies: list[int], link: int
) -> tuple[float, Array, Array, Array]:
    """Mass, centre, principal axes (3, 3) and moments of bodies as one, in the link's frame."""
    masses = np.array([float(m.body_mass[b]) for b in bodies])
    frames = [_relative(data, link, data.xipos[b], data.ximat[b]) for b in bodies]
    mass = float(masses.sum())
    centre = masses @ np.array([place for place, _ in frames]) / mass
    heavy = [k for k, b in enumerate(bodies) if m.body_mass[b] > 0 or m.body_inertia[b].any()]
    if len(heavy) == 1:  # nothing to add up: the file's own values
        return mass, frames[heavy[0]][0], frames[heavy[0]][1], m.body_inertia[bodies[heavy[0]]]
    tensor = np.zeros((3, 3))
    for b, (place, axes) in zip(bodies, frames, strict=True):
        lever = place - centre
        tensor += axes @ np.diag(m.body_inertia[b]) @ axes.T
        tensor += m.body_mass[b] * (lever @ lever * np.eye(3) - np.outer(lever, lever))
    moments, axes = principal(tensor)
    return mass, centre, axes, moments
