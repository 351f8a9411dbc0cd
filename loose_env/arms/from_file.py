"""Arms built from MJCF or URDF files, with proposed torque limits and levels; file report."""

from __future__ import annotations

import warnings as python_warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import mujoco
import numpy as np

from loose_env.arms.arm import Arm, Holding, HoldKind, checked_hold, limits_of
from loose_env.arms.file_chain import TOOL_SITE, Chain, chain_spec, find_chain
from loose_env.arms.holding import (
    CREST_FACTOR,
    FASTEST_TURN,
    GRAVITY,
    WHEEL_TURN,
    add_wheel,
    fastest_turn,
    held,
    holdings,
    inertias,
    poses_of,
    proposed_gears,
    rounded,
    settling_time,
)
from loose_env.arms.linear import LinearArm
from loose_env.arms.model_file import ModelFile, read_model_file
from loose_env.errors import InvalidData, InvalidSetting
from loose_env.typing import Array

AT_LEAST = 1.0
"""Peak tool acceleration beyond gravity for which a proposed torque limit is made [g]."""
TIMESTEP = 2e-4
"""Simulation step, unless a joint's damper or spring needs a shorter one [s]."""
_SHORTEST = TIMESTEP / 16
_TRACE = 1e-10
_SPRUNG_POINTS = 120  # frequencies, where springs have modes that can lie in the band
_GRAVITY_SPARE = 2.0  # a drive holds twice the gravity load
_MOST_DECAY = 0.2
"""Largest decay of a centring damper within half a step [1]. The rig makes up for the half step
with rotor inertia, which the mismatch draws up to 9 % smaller and the damper up to 30 % larger; of
what explicit steps can bear, a drawn stop on the same flange takes up to seven tenths."""


def propose_limits(model: mujoco.MjModel, joints: list[str], poses: Array) -> Array:
    """Propose torque limits: twice the gravity load, and 1 g at the tool besides."""
    data = mujoco.MjData(model)
    site = model.site("tool").id
    dofs = [int(model.joint(j).dofadr[0]) for j in joints]
    at = [int(model.joint(j).qposadr[0]) for j in joints]
    full, jacobian = np.zeros((model.nv, model.nv)), np.zeros((3, model.nv))
    load, shake = np.zeros(len(joints)), []
    for pose in poses:
        data.qpos[at] = pose
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, full)
        mujoco.mj_jacSite(model, data, jacobian, None, site)
        load = np.maximum(load, np.abs(data.qfrc_bias[dofs]))
        lever = np.linalg.norm(jacobian[:, dofs], axis=0)
        # A joint whose axis meets the tool is shaken as one that lies 0.1 m beside it.
        shake.append(full[dofs, dofs] * GRAVITY * AT_LEAST / np.maximum(lever, 0.1))
    limits = _GRAVITY_SPARE * load + np.median(shake, axis=0)
    return np.array([float(f"{x:.2g}") for x in limits])


def propose_levels(arm: Arm, poses: Array) -> tuple[float, float, float]:
    """Three levels whose top half of all poses and joints can reach.

    The tool's rms acceleration in the band that each joint reaches alone, with the torque that
    is left beside gravity and peaks of three times the rms (`CREST_FACTOR`); the top level is
    the median over poses and joints that move the tool, the others a third and a ninth of it.
    """
    sprung = arm.gear_joints and arm.rigid is None  # by the file
    linear = LinearArm(arm, points=_SPRUNG_POINTS if sprung else 12)
    reachable = []
    for pose in poses:
        at = linear.at(pose)
        spare = np.maximum(np.array(arm.torque_limits) - np.abs(at.gravity_torque), 0.0)
        moves = np.linalg.norm(at.kinematic, axis=0) > 1e-6
        for j in np.flatnonzero(moves):
            tool = at.response(np.arange(arm.n) == j).tool
            per_torque = np.sqrt(np.mean(np.sum(np.abs(tool[:, :, 0]) ** 2, axis=1)))
            reachable.append(per_torque * spare[j] / CREST_FACTOR)
    if not reachable:
        raise InvalidData(
            f"arm {arm.name!r}: no joint moves its tool, which lies on the axis of every one: add "
            "a site beside the axis to the last body, or name a site or body farther out: tool=..."
        )
    top = float(f"{np.median(reachable):.2g}")
    if not top > 0:
        raise InvalidData(
            f"arm {arm.name!r}: in most poses no torque is left to shake the tool: the limits "
            f"{arm.torque_limits} hardly hold it against gravity; raise them in the file"
        )
    return float(f"{top / 9:.2g}"), float(f"{top / 3:.2g}"), top


def stable_timestep(arm: Arm, poses: Array) -> float:
    """Find a step that resolves the file's dampers and springs, with every seat open.

    The rig takes them explicitly, and behind an open seat they act on the flange alone. The step
    is halved until no mode of theirs decays or turns by more than 1 in a step.
    """
    linear = LinearArm(arm, points=2)
    joints = linear.joint_dofs
    damping = linear.model.dof_damping[joints]
    stiffness = linear.model.jnt_stiffness[linear.model.dof_jntid[joints]]
    decay = turn = 0.0
    for weight in _flange_weights(linear, poses):
        decay = max(decay, float(np.linalg.eigvals(weight * damping).real.max()))
        turn = max(turn, float(np.linalg.eigvals(weight * stiffness).real.max()))
    step = TIMESTEP
    while step * decay > 1 or step**2 * turn > 1:
        step /= 2
        if step < _SHORTEST:
            raise InvalidData(
                f"arm {arm.name!r}: damping {damping.tolist()} and stiffness "
                f"{stiffness.tolist()} of its joints are too large for its inertias: a step of "
                f"{min(1 / max(decay, 1e-12), max(turn, 1e-12) ** -0.5):.1g} s would be needed; "
                "lower them in the file, or give the joints a rotor inertia (armature)"
            )
    return step


def calm_centring(arm: Arm, poses: Array) -> Holding:
    """Weaken the centring dampers that would be too fast for the step with every seat open.

    Behind an open seat they act on the flange alone, which can be a thousandth of what the joint
    carries where the file gives it no rotor inertia. Their springs stay.
    """
    weights = _flange_weights(LinearArm(arm, points=2), poses)
    damping = np.array(arm.centring.damping)
    most = 2 * _MOST_DECAY / arm.timestep
    lightest = np.einsum("pjj->pj", weights).max(axis=0)
    calm = np.minimum(damping, most / lightest)
    together = max(float(np.linalg.eigvals(w * calm).real.max()) for w in weights)
    calm = np.where(calm < damping, calm * min(1.0, most / together), damping)
    return Holding(stiffness=arm.centring.stiffness, damping=rounded(calm))


def _flange_weights(linear: LinearArm, poses: Array) -> Array:
    """Inverse inertia of the joints in every pose, with every seat open (m, n, n)."""
    inertia = np.array([linear.at(pose).inertia for pose in poses])
    # Play along a sliding joint and the slides of its link are one motion: a trace more of each
    # inertia lets them be solved, and changes nothing of what the joints feel.
    own = np.arange(inertia.shape[1])
    inertia[:, own, own] *= 1 + _TRACE
    joints = linear.joint_dofs
    unit = np.eye(len(own))[:, joints]
    return np.asarray(np.linalg.solve(inertia, np.tile(unit, (len(poses), 1, 1)))[:, joints])


_HALVINGS = 4


def with_file_springs(arm: Arm, springs: tuple[str, ...]) -> Arm:
    """Make an arm whose spec holds elastic joints ready for the rig.

    The rig preloads the springs against gravity, as it does those of gears. Behind an open seat
    the flange is all that is left on the spring of its drive: where it is too light for the step, a
    part of the rotor's inertia is moved to it, so that both together stay as they were; where
    that is not enough the step is halved. Records wait until the springs' modes have died away.
    """
    if not springs:
        return arm
    arm = replace(arm, gear_joints=springs)
    for halving in range(_HALVINGS + 1):
        made = _with_wheels(arm, arm.timestep / 2**halving)
        if made is not None and fastest_turn(made) <= FASTEST_TURN:
            return replace(made, settling=settling_time(made, _lowest_damping(made)))
    stiffness = [float(arm.model.joint(name).stiffness[0]) for name in springs]
    raise InvalidData(
        f"arm {arm.name!r}: the springs of joints {', '.join(springs)} with {stiffness} are too "
        f"stiff to simulate, even with a step of {arm.timestep / 2**_HALVINGS:.1g} s; lower them "
        "in the file, or take the joints out where they are as good as rigid"
    )


def _of_drives(arm: Arm) -> list[tuple[int, str]]:
    """Springs that stand behind a drive on its flange, each with the number of its joint."""
    m = arm.model
    flanges = [int(m.joint(name).bodyid[0]) for name in arm.joints]
    places = [(int(m.joint(spring).bodyid[0]), spring) for spring in arm.gear_joints]
    return [(flanges.index(body), spring) for body, spring in places if body in flanges]


def _with_wheels(arm: Arm, step: float) -> Arm | None:
    """Return the arm with a step and flanges heavy enough for it; None if rotors do not suffice."""
    spec = arm.spec.copy()
    _, own, _ = inertias(arm)
    m = arm.model
    for j, spring in _of_drives(arm):
        stiffness = float(m.joint(spring).stiffness[0])
        damping = float(m.joint(spring).damping[0])
        needed = stiffness * (step / WHEEL_TURN) ** 2 + step * damping
        joint = spec.joint(arm.joints[j])
        moved = max(needed - float(own[j]), 0.0)
        if joint.armature - moved < needed:
            return None
        if moved > 0:
            joint.armature -= moved
            axis = np.asarray(joint.axis, dtype=float)
            slides = joint.type == mujoco.mjtJoint.mjJNT_SLIDE
            add_wheel(joint.parent, moved, axis / np.linalg.norm(axis), slides=slides)
    return replace(arm, spec=spec, timestep=step)


def _lowest_damping(arm: Arm) -> float:
    """Smallest damping ratio of a spring with all that it carries, the rest held [1]."""
    m, data = arm.model, mujoco.MjData(arm.model)
    full = np.zeros((m.nv, m.nv))
    lowest = np.inf
    for pose in poses_of(arm):
        data.qpos[arm.pose_addresses] = pose
        mujoco.mj_forward(m, data)
        mujoco.mj_fullM(m, data, full)
        for name in arm.gear_joints:
            joint = m.joint(name)
            carried = full[joint.dofadr[0], joint.dofadr[0]]
            critical = 2 * np.sqrt(float(joint.stiffness[0]) * carried)
            lowest = min(lowest, float(joint.damping[0]) / critical)
    return lowest


@dataclass(frozen=True, kw_only=True)
class FoundJoint:
    """A driven joint of a file."""

    name: str
    kind: Literal["hinge", "slide"]
    range: tuple[float, float] | None
    """Allowed positions [rad or m]; None where it has no limits."""
    torque_limit: float | None
    """Peak drive torque [N·m, or N where it slides]; None where the file says nothing."""


@dataclass(frozen=True, kw_only=True)
class Payload:
    """A branch that rides on a link, its joints frozen."""

    body: str
    link: str
    joints: tuple[str, ...]
    mass: float
    """Mass of the branch [kg]."""


@dataclass(frozen=True, kw_only=True)
class FileReport:
    """Joints, links, tool and payload of a file. Its text is a table."""

    file: str
    format: Literal["MJCF", "URDF"]
    joints: tuple[FoundJoint, ...]
    """Driven joints, base first."""
    links: tuple[str, ...]
    """Body that each joint moves."""
    link_masses: tuple[float, ...]
    """Mass of each link with all that rides on it [kg]."""
    tool: str
    """Site of the tool, or the body whose frame it is."""
    tool_origin: str
    """Origin of the tool, in words."""
    payload: tuple[Payload, ...]
    gravity: tuple[float, float, float]
    """Gravity [m/s²]."""
    warnings: tuple[str, ...]
    """Elements left out, and assumptions."""
    springs: tuple[str, ...] = ()
    """Elastic joints, which bend and have no drive, base first."""
    spring_modes: tuple[float, ...] = ()
    """Mode of each with all it carries, everything else held, where the file has it [Hz]."""

    def __str__(self) -> str:
        rows = [("", "joint", "kind", "range", "peak torque", "link", "mass")]
        for number, (joint, link, mass) in enumerate(
            zip(self.joints, self.links, self.link_masses, strict=True), start=1
        ):
            hinge = joint.kind == "hinge"
            low, high = joint.range or (0.0, 0.0)
            span = f"{low:.3g} to {high:.3g} {'rad' if hinge else 'm'}"
            unit = "N·m" if hinge else "N"
            limit = joint.torque_limit
            rows.append(
                (
                    str(number),
                    joint.name,
                    joint.kind,
                    "no limits" if joint.range is None else span,
                    "not given" if limit is None else f"{limit:.3g} {unit}",
                    link,
                    f"{mass:.3g} kg",
                )
            )
        widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
        lines = [f"{self.file} ({self.format}): {len(self.joints)} joints"]
        lines += [
            "  ".join(c.ljust(w) for c, w in zip(r, widths, strict=True)).rstrip() for r in rows
        ]
        lines.append(f"tool: {self.tool}, {self.tool_origin}")
        for spring, mode in zip(self.springs, self.spring_modes, strict=True):
            lines.append(f"elastic: {spring}, {mode:.3g} Hz with all it carries")
        for branch in self.payload:
            frozen = f", frozen: {', '.join(branch.joints)}" if branch.joints else ""
            lines.append(f"payload: {branch.body} on {branch.link}, {branch.mass:.3g} kg{frozen}")
        lines += [f"note: {warning}" for warning in self.warnings]
        return "\n".join(lines)


def report(file: ModelFile, chain: Chain) -> FileReport:
    """Report the chain of a file."""
    m = file.model
    found = tuple(
        FoundJoint(
            name=m.joint(j).name,
            kind="slide" if m.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE else "hinge",
            range=(float(m.jnt_range[j][0]), float(m.jnt_range[j][1]))
            if m.jnt_limited[j]
            else None,
            torque_limit=_torque_limit(file, j),
        )
        for j in chain.joints
    )
    owner = np.array(chain.owner)
    masses = tuple(float(m.body_mass[owner == k].sum()) for k in range(1, len(found) + 1))
    body = m.body(chain.tool_body).name
    off = m.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY
    gravity = np.zeros(3) if off else m.opt.gravity
    return FileReport(
        file=file.path.name,
        format=file.format,
        joints=found,
        links=tuple(m.body(b).name for b in chain.links),
        link_masses=masses,
        tool=body if chain.tool_site is None else m.site(chain.tool_site).name,
        tool_origin=chain.tool_origin,
        payload=_payload(m, chain),
        gravity=(float(gravity[0]), float(gravity[1]), float(gravity[2])),
        warnings=(*file.warnings, *chain.warnings, *_left_out(m, chain)),
        springs=tuple(m.joint(j).name for j in chain.springs),
        spring_modes=_modes(m, chain.springs),
    )


def _modes(m: mujoco.MjModel, springs: tuple[int, ...]) -> tuple[float, ...]:
    """Mode of each spring with all that it carries [Hz]."""
    data = mujoco.MjData(m)
    mujoco.mj_forward(m, data)
    inertia = np.zeros((m.nv, m.nv))
    mujoco.mj_fullM(m, data, inertia)
    dofs = [int(m.jnt_dofadr[j]) for j in springs]
    return tuple(
        float(np.sqrt(m.jnt_stiffness[j] / inertia[d, d]) / (2 * np.pi))
        for j, d in zip(springs, dofs, strict=True)
    )


def _payload(m: mujoco.MjModel, chain: Chain) -> tuple[Payload, ...]:
    """Branches that begin at a frozen joint of a link."""
    branches = []
    bending = {int(m.jnt_bodyid[j]) for j in chain.springs}
    for body in range(1, m.nbody):
        parent = int(m.body_parentid[body])
        own = chain.owner[body]
        if own == 0 or body in (*chain.links, *bending) or not m.body_jntnum[body]:
            continue
        carriers = [m.body_weldid[b] for b in (chain.links[own - 1], *bending)]
        if m.body_weldid[parent] not in carriers:
            continue  # further out on a branch
        inside = [b for b in range(body, m.nbody) if _under(m, b, body)]
        branches.append(
            Payload(
                body=m.body(body).name,
                link=m.body(chain.links[own - 1]).name,
                joints=tuple(
                    m.joint(j).name for j in range(m.njnt) if int(m.jnt_bodyid[j]) in inside
                ),
                mass=float(m.body_mass[inside].sum()),
            )
        )
    return tuple(branches)


def _under(m: mujoco.MjModel, body: int, root: int) -> bool:
    while body > root:
        body = int(m.body_parentid[body])
    return body == root


def _left_out(m: mujoco.MjModel, chain: Chain) -> list[str]:
    notes = []
    data = mujoco.MjData(m)
    mujoco.mj_forward(m, data)
    place = (
        data.xpos[chain.tool_body] if chain.tool_site is None else data.site_xpos[chain.tool_site]
    )
    for j in chain.joints:
        dof = int(m.jnt_dofadr[j])
        name, axis = m.joint(j).name, data.xaxis[j]
        if m.dof_frictionloss[dof] > 0:
            notes.append(
                f"dry friction of {m.dof_frictionloss[dof]:.3g} in joint {name} is left out"
            )
        if np.any(m.jnt_stiffnesspoly[j]) or np.any(m.dof_dampingpoly[dof]):
            notes.append(f"joint {name}: spring and damper are kept to first order")
        if m.jnt_type[j] == mujoco.mjtJoint.mjJNT_HINGE:
            lever = float(np.linalg.norm(np.cross(axis, place - data.xanchor[j])))
            if lever < 1e-3 and j == chain.joints[-1]:
                notes.append(
                    f"the tool lies on the axis of joint {name} and does not feel it turn; a "
                    "site beside the axis would"
                )
    if m.body_gravcomp[list(chain.links)].any():
        notes.append("gravity compensation is left out: the drives hold the arm")
    return notes


def _torque_limit(file: ModelFile, j: int) -> float | None:
    """The tighter of what the joint and its actuators allow; None where neither says."""
    m = file.model
    drives = [d for d in file.drives if d.joint == m.joint(j).name]
    found = []
    if m.jnt_actfrclimited[j]:
        found.append(float(np.abs(m.jnt_actfrcrange[j]).max()))
    if drives and all(d.limit is not None for d in drives):
        found.append(sum(d.limit for d in drives if d.limit is not None))
    found = [x for x in found if np.isfinite(x) and x > 0]
    return min(found, default=None)


DESK_ARM = Path(__file__).parent / "models" / "desk_arm.xml"
"""A small arm of six joints with a gripper, to try things on."""
SERVO_ARM = Path(__file__).parent / "models" / "servo_arm.xml"
"""A waist, a shoulder and an elbow on position servos."""
SIX_AXIS_SERVO_ARM = Path(__file__).parent / "models" / "six_axis_servo_arm.xml"
"""The arm of `loose_env.arms.six_axis` on position servos."""

_POSES = 24
"""Poses at which loads, inertias and levels are looked at."""
_STROKE = 0.25
"""Range of a slide without limits, to either side of where the file has it [m]."""


def describe_file(
    path: str | Path, *, tool: str | None = None, joints: Sequence[str] | None = None
) -> FileReport:
    """Report what `arm_from_file` finds in a file, without building the arm.

    Raises as `arm_from_file`.

    Examples
    --------
    >>> report = describe_file(DESK_ARM)
    >>> [joint.name for joint in report.joints][:2]
    ['base', 'shoulder']
    """
    file = read_model_file(path)
    return report(file, find_chain(file, tool, joints))


def arm_from_file(
    path: str | Path,
    *,
    tool: str | None = None,
    tool_offset: Sequence[float] = (0.0, 0.0, 0.0),
    joints: Sequence[str] | None = None,
    hold: HoldKind = "brake",
) -> Arm:
    """Build an arm from an MJCF or URDF file of a serial chain on a fixed base.

    Kinematics, inertias, rotor inertias, viscous friction, springs, gravity and the force
    limits of the drives are those of the file; actuators, sensors, contacts, geoms, keyframes and
    solver options are left out. Each link is split into a flange that carries the joint and
    the link itself, with the seat between them; their sum is the link of the file. Joints of
    branches, a gripper's fingers, are frozen where the file has them and ride along.

    Dry friction and the stops of the joints are left out: the linear prediction has none.
    A joint's spring is kept, and acts about the pose that is held. A joint with a spring and no
    drive, in a file whose other joints have drives, is elastic: it bends, is neither shaken nor
    held, and is no link of its own. That is what `loose gap` puts behind a drive that gives way;
    play that it adds is taken as fixed, for the nominal arm is sound. Torque limits that the file
    does not give are proposed from the gravity load and the inertia, with a Python warning.

    Parameters
    ----------
    path : str or Path
        The file. It may include files from its own folder.
    tool : str, optional
        Site or body that carries the tool accelerometer. By default a site called ``tool``;
        else the last site of the last body of the deepest chain, else that body's frame.
    tool_offset : sequence of 3 floats
        Moves the accelerometer in the tool's frame [m]: off the last joint's axis, where it does
        not feel that joint turn.
    joints : sequence of str, optional
        Driven joints. By default all between the base and the tool that are not elastic.
    hold : {"brake", "servo", "compliant"}
        How joints that are not excited are held; see `loose_env.arms.holding`. Elastic
        gears have the figures of `loose_env.arms.holding.proposed_gears`.

    Returns
    -------
    Arm
        With three tool axes, a band of 30 to 150 Hz, and levels of which most poses reach the
        top one.

    Raises
    ------
    InvalidSetting
        If there is no such file, or gears are asked for and the file has elastic joints.
    InvalidData
        If it is no MJCF or URDF, refers to anything outside its folder, does not compile, or
        is no serial chain: a floating base, ball joints, closed loops, two joints on one
        body; or if its drives cannot shake the tool, or its dampers are too stiff to simulate.
    UnknownName
        If there is no such tool, joint or hold.

    Warns
    -----
    UserWarning
        Where torque limits or the range of a slide are proposed, and where the tool lies on a
        joint's axis, so that play in this joint is no hypothesis.

    Examples
    --------
    >>> import tempfile
    >>> text = '''<mujoco><worldbody>
    ... <body name="link"><joint name="turn" actuatorfrcrange="-5 5"/>
    ...   <inertial pos=".2 0 0" mass="1" diaginertia=".01 .01 .01"/>
    ...   <site name="tip" pos=".4 .1 0"/></body></worldbody></mujoco>'''
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder, "one.xml")
    ...     _ = file.write_text(text)
    ...     arm = arm_from_file(file)
    >>> arm.joints, arm.torque_limits
    (('turn',), (5.0,))
    """
    checked_hold(hold)
    file = read_model_file(path)
    chain = find_chain(file, tool, joints)
    found = report(file, chain)
    if chain.springs and hold == "compliant":
        raise InvalidSetting(
            f"{found.file}: the file has elastic joints of its own "
            f"({', '.join(found.springs)}); hold='compliant' would add gears to them. Take "
            "hold='brake' or 'servo': the file's springs are in either"
        )
    spec, names, links, springs = chain_spec(file, chain, _offset(tool_offset))
    ranges = tuple(_range(file.model, j) for j in chain.joints)
    low, high = limits_of(ranges)
    rng = np.random.default_rng(0)  # the same file always gives the same arm
    poses = low + (high - low) * rng.random((_POSES, len(names)))

    bare = spec.copy().compile()
    given = [j.torque_limit for j in found.joints]
    limits = given
    if None in given:
        proposed = propose_limits(bare, names, poses)
        limits = [float(p) if g is None else g for g, p in zip(given, proposed, strict=True)]
    assumed = _assumed(found, limits, file.model, chain)
    if assumed:
        python_warnings.warn(f"{found.file}: {'; '.join(assumed)}", UserWarning, stacklevel=2)
    brake, servo, centring = holdings(spec, names, poses=poses)
    arm = Arm(
        name=file.name,
        spec=spec,
        joints=tuple(names),
        seat_bodies=tuple(links),
        tool=TOOL_SITE,
        axes=(0, 1, 2),
        torque_limits=tuple(float(x) for x in limits if x is not None),
        joint_ranges=ranges,
        levels=(1.0, 3.0, 9.0),
        band=(30.0, 150.0),
        brake=brake,
        servo=servo,
        centring=centring,
        timestep=TIMESTEP,
        settling=0.1,
    )
    arm = replace(arm, timestep=stable_timestep(arm, poses))
    arm = with_file_springs(arm, springs)
    arm = replace(arm, centring=calm_centring(arm, poses))
    arm = held(replace(arm, gears=proposed_gears(arm)), hold)
    arm = replace(arm, levels=propose_levels(arm, poses))
    if unfelt := unfelt_words(arm):
        python_warnings.warn(f"{found.file}: {unfelt}", UserWarning, stacklevel=2)
    return arm


def unfelt_words(arm: Arm) -> str:
    """Say which joints the tool does not feel, and what to do; empty where it feels all.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> unfelt_words(planar(2))
    ''
    """
    if not arm.unfelt_joints:
        return ""
    names = ", ".join(arm.joints[j - 1] for j in arm.unfelt_joints)
    return (
        f"the tool lies on the axis of {names}: it does not feel play there, which is therefore no "
        "hypothesis; tool_offset=(0.05, 0, 0) moves the accelerometer 50 mm along the tool's x axis"
    )


def _assumed(
    found: FileReport, limits: Sequence[float | None], m: mujoco.MjModel, chain: Chain
) -> list[str]:
    assumed = []
    proposed = [
        f"{joint.name} {limit:g} {'N·m' if joint.kind == 'hinge' else 'N'}"
        for joint, limit in zip(found.joints, limits, strict=True)
        if joint.torque_limit is None
    ]
    if proposed:
        assumed.append(
            f"the file gives no torque limits for some joints; proposed from gravity load "
            f"and inertia: {', '.join(proposed)}"
        )
    assumed += [
        f"slide {m.joint(j).name} has no limits; {_STROKE:g} m to either side is assumed"
        for j in chain.joints
        if not m.jnt_limited[j] and m.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE
    ]
    return assumed


def _offset(given: Sequence[float]) -> Array:
    """Check the offset of the tool."""
    try:
        offset = np.asarray(given, dtype=float)
    except (TypeError, ValueError):
        offset = np.zeros(0)
    if offset.shape != (3,) or not np.isfinite(offset).all():
        raise InvalidSetting(f"tool_offset is three finite lengths in metres, got {given!r}")
    return offset


def _range(m: mujoco.MjModel, j: int) -> tuple[float, float] | None:
    if m.jnt_limited[j]:
        return float(m.jnt_range[j][0]), float(m.jnt_range[j][1])
    if m.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE:
        middle = float(m.qpos0[int(m.jnt_qposadr[j])])
        return middle - _STROKE, middle + _STROKE
    return None
