"""Any serial arm, read from an MJCF or URDF file."""

from __future__ import annotations

import warnings as python_warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import get_args

import mujoco
import numpy as np

from loose_env.arms.arm import Arm, HoldKind
from loose_env.arms.files.chain_spec import TOOL_SITE, chain_spec
from loose_env.arms.files.drive_limits import (
    TIMESTEP,
    calm_centring,
    propose_levels,
    propose_limits,
    stable_timestep,
    with_file_springs,
)
from loose_env.arms.files.model_reader import ModelFile, read_model_file
from loose_env.arms.files.report import FileReport, FoundJoint, Payload, report
from loose_env.arms.files.serial_chain import Chain, find_chain
from loose_env.arms.holding.compliance import held
from loose_env.arms.holding.gears import proposed_gears
from loose_env.arms.spec_parts import holdings
from loose_env.errors import InvalidSetting, UnknownName
from loose_env.typing import Array

__all__ = [
    "DESK_ARM",
    "SERVO_ARM",
    "SIX_AXIS_SERVO_ARM",
    "FileReport",
    "FoundJoint",
    "Payload",
    "arm_from_file",
    "arm_of_model_file",
    "describe_file",
    "unfelt_words",
]

DESK_ARM = Path(__file__).parents[1] / "models" / "desk_arm.xml"
"""A small arm of six joints with a gripper, to try things on."""
SERVO_ARM = Path(__file__).parents[1] / "models" / "servo_arm.xml"
"""A waist, a shoulder and an elbow on position servos."""
SIX_AXIS_SERVO_ARM = Path(__file__).parents[1] / "models" / "six_axis_servo_arm.xml"
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
        How joints that are not excited are held; see `loose_env.arms.holding.compliance`. Elastic
        gears have the figures of `loose_env.arms.holding.gears.proposed_gears`.

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
    file = read_model_file(path)
    arm = arm_of_model_file(file, tool=tool, tool_offset=tool_offset, joints=joints, hold=hold)
    unfelt = unfelt_words(arm)
    if unfelt:
        python_warnings.warn(f"{file.path.name}: {unfelt}", UserWarning, stacklevel=2)
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


def arm_of_model_file(
    file: ModelFile,
    *,
    tool: str | None = None,
    tool_offset: Sequence[float] = (0.0, 0.0, 0.0),
    joints: Sequence[str] | None = None,
    hold: HoldKind = "brake",
) -> Arm:
    """Build an arm from a model file that has been read; see `arm_from_file`."""
    if hold not in get_args(HoldKind):
        raise UnknownName(f"unknown hold {hold!r}; known are {list(get_args(HoldKind))}")
    chain = find_chain(file, tool, joints)
    found = report(file, chain)
    if chain.springs and hold == "compliant":
        raise InvalidSetting(
            f"{found.file}: the file has elastic joints of its own "
            f"({', '.join(found.springs)}); hold='compliant' would add gears to them. Take "
            "hold='brake' or 'servo': the file's springs are in either"
        )
    made = chain_spec(file, chain, _offset(tool_offset))
    spec, names, links = made.spec, list(made.joints), list(made.links)
    ranges = tuple(_range(file.model, j) for j in chain.joints)
    low = np.array([-np.pi if r is None else r[0] for r in ranges])
    high = np.array([np.pi if r is None else r[1] for r in ranges])
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
        python_warnings.warn(f"{found.file}: {'; '.join(assumed)}", UserWarning, stacklevel=3)
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
    arm = with_file_springs(arm, made.springs)
    arm = replace(arm, centring=calm_centring(arm, poses))
    arm = held(replace(arm, gears=proposed_gears(arm)), hold)
    return replace(arm, levels=propose_levels(arm, poses))


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
