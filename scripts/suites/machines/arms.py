"""Random serial arms as MuJoCo models: the nominal one and the true one."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

GRAVITY = 9.81
"""m/s²."""
STEP = 1 / 16_000
"""Integration step of the true machine [s]; servo rates divide its inverse."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Arm:
    """Parameters of a serial arm of hinge joints, base first."""

    ends: Array
    """Distal end of each link in its own frame [m] (n, 3)."""
    axes: Array
    """Axis of each joint in its link's frame (n, 3)."""
    masses: Array
    """Mass of each link [kg] (n,)."""
    centres: Array
    """Centre of mass of each link [m] (n, 3)."""
    inertias: Array
    """Principal inertias of each link about its centre, along its frame [kg m²] (n, 3)."""
    armature: Array
    """Rotor inertia behind the gear [kg m²] (n,)."""
    damping: Array
    """Viscous friction of each joint [N m s] (n,)."""
    limit: Array
    """Peak torque of each drive [N m] (n,)."""
    kp: Array
    """Stiffness of each position servo [N m/rad] (n,)."""
    kv: Array
    """Damping of each position servo [N m s/rad] (n,)."""
    tool: Array
    """Location of the accelerometer in the last link's frame [m] (3,)."""
    servoed: bool
    """True for position servos, False for torque motors with an outer controller."""

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.masses)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Fault:
    """A loose connection."""

    kind: str
    """"structural_looseness" or "backlash"."""
    link: int
    """Link or joint, 0 at the base."""
    direction: tuple[float, float, float]
    """Unit vector of the slide in the link's frame; of backlash the joint's axis."""
    gap: float
    """Free travel [m], of backlash [rad]."""
    friction: float
    """Friction of the guide [N], of backlash [N m]."""
    stop: float
    """Time constant of the stops [s]."""

    @property
    def hypothesis(self) -> str:
        """Name of the hypothesis that is true."""
        where = "link" if self.kind == "structural_looseness" else "joint"
        return f"{self.kind}@{where}{self.link + 1}"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Extras:
    """Joints that the true machine has beside those of the nominal model."""

    gears: bool = False
    """True if a spring lies between every motor and its link."""
    bent: tuple[int, ...] = ()
    """Links with a hinge of their own, 0 at the base."""
    base: bool = False
    """True if the base slides and rocks."""
    fault: Fault | None = None
    """What is loose."""


def draw_arm(rng: np.random.Generator) -> Arm:
    """Draw an arm of 3 to 7 joints."""
    n = int(rng.integers(3, 8))
    lengths = rng.uniform(0.1, 0.5, n) * min(1.0, 4.5 / n)
    lengths = np.maximum(lengths, 0.1)
    masses = np.sort(np.exp(rng.uniform(np.log(0.8), np.log(8.0), n)))[::-1].copy()
    along = np.zeros(n, dtype=int)
    axes = np.zeros((n, 3))
    last = 2 if rng.random() < 0.8 else 1
    for i in range(n):
        if i > 0:
            others = [k for k in range(3) if k != last and not (k == 0 and last == 0)]
            stays = rng.random() < 0.35 and last != 0
            last = last if stays else int(rng.choice(others))
        axes[i, last] = 1.0
        along[i] = 2 if i == 0 and last == 2 else 0
    ends, centres, inertias = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3))
    for i in range(n):
        ends[i, along[i]] = lengths[i]
        ends[i, 1] += rng.choice([0.0, 0.0, 1.0]) * rng.uniform(-0.1, 0.1)
        centres[i] = rng.uniform(0.35, 0.6) * ends[i] + rng.uniform(-0.01, 0.01, 3)
        radius = rng.uniform(0.03, 0.06)
        inertias[i] = masses[i] * (3 * radius**2 + lengths[i] ** 2) / 12
        inertias[i, along[i]] = masses[i] * radius**2 / 2
    tool = ends[-1] + np.array([0.0, *(rng.choice([-1, 1], 2) * rng.uniform(0.03, 0.08, 2))])
    bare = Arm(
        ends=ends, axes=axes, masses=masses, centres=centres, inertias=inertias,
        armature=np.zeros(n), damping=np.zeros(n), limit=np.ones(n), kp=np.zeros(n),
        kv=np.zeros(n), tool=tool, servoed=bool(rng.random() < 0.7),
    )  # fmt: skip
    return _driven(bare, rng)


def _driven(arm: Arm, rng: np.random.Generator) -> Arm:
    """Rotors, friction and torque limits to suit the links."""
    n = arm.joints
    model = mujoco.MjModel.from_xml_string(nominal_xml(arm))
    data = mujoco.MjData(model)
    weight, inertia = np.zeros(n), np.zeros(n)
    for _ in range(200):
        data.qpos[:] = rng.uniform(-1.5, 1.5, n)
        mujoco.mj_forward(model, data)
        weight = np.maximum(weight, np.abs(data.qfrc_bias))
        inertia = np.maximum(inertia, np.diag(_inertia(model, data)))
    share = np.geomspace(rng.uniform(1.0, 2.0), rng.uniform(0.3, 0.8), n)
    armature = share * inertia
    limit = 1.5 * weight + rng.uniform(40.0, 120.0) * (inertia + armature)
    damping = rng.uniform(0.005, 0.03, n) * limit
    return dataclasses.replace(arm, armature=armature, limit=limit, damping=damping)


def with_gains(arm: Arm, hertz: Array, ratio: Array) -> Arm:
    """Servo gains by the frequency [Hz] and damping ratio of each joint alone (n,)."""
    model = mujoco.MjModel.from_xml_string(nominal_xml(arm))
    data = mujoco.MjData(model)
    data.qpos[:] = 0.7
    mujoco.mj_forward(model, data)
    inertia = np.diag(_inertia(model, data))
    omega = 2 * np.pi * hertz
    kp = inertia * omega**2
    kv = np.maximum(2 * ratio * inertia * omega - arm.damping, 0.1 * inertia * omega)
    return dataclasses.replace(arm, kp=kp, kv=kv)


def altered(arm: Arm, relative: float, rng: np.random.Generator) -> Arm:
    """Return the arm as built, its parameters off by a relative standard deviation."""
    n = arm.joints

    def off(size: float, *shape: int) -> Array:
        return np.exp(size * np.clip(rng.normal(size=shape), -2.5, 2.5))

    length = relative / 15
    return dataclasses.replace(
        arm,
        ends=arm.ends * off(length, n, 1),
        masses=arm.masses * off(relative, n),
        centres=arm.centres * off(relative, n, 1),
        inertias=arm.inertias * off(relative, n, 1),
        armature=arm.armature * off(relative, n),
        damping=arm.damping * off(5 * relative, n),
        tool=arm.tool * off(length, 1),
    )


def nominal_xml(arm: Arm) -> str:
    """MJCF of the model that the user has."""
    lines = []
    for i in range(arm.joints):
        lines.append(_body(arm, i))
        lines.append(
            f'<joint name="joint{i + 1}" axis="{_text(arm.axes[i])}" range="-3.1 3.1" '
            f'limited="true" armature="{arm.armature[i]:.8g}" damping="{arm.damping[i]:.8g}"/>'
        )
        lines.append(_inertial(arm, i, 1.0, np.zeros(3)))
    lines.append(f'<site name="tool" pos="{_text(arm.tool)}"/>')
    lines += ["</body>"] * arm.joints
    drives = []
    for i in range(arm.joints):
        limit = f'forcerange="{-arm.limit[i]:.8g} {arm.limit[i]:.8g}" forcelimited="true"'
        if arm.servoed:
            drives.append(
                f'<position name="servo{i + 1}" joint="joint{i + 1}" kp="{arm.kp[i]:.8g}" '
                f'kv="{arm.kv[i]:.8g}" {limit}/>'
            )
        else:
            drives.append(f'<motor name="servo{i + 1}" joint="joint{i + 1}" {limit}/>')
    sensors = []
    for i in range(arm.joints):
        sensors.append(f'<jointpos name="joint{i + 1}_pos" joint="joint{i + 1}"/>')
        sensors.append(f'<jointvel name="joint{i + 1}_vel" joint="joint{i + 1}"/>')
    sensors.append('<accelerometer name="tool_acc" site="tool"/>')
    return _model(0.0005, lines, drives, sensors)


def true_xml(arm: Arm, extras: Extras) -> str:
    """MJCF of the machine: torque motors, extra joints without their stiffness yet.

    Extra joints are named gear1, bend1, base_x, base_y, base_roll, base_pitch and seat.
    """
    lines = []
    fault = extras.fault
    if extras.base:
        lines.append('<body name="base"><inertial pos="0 0 0" mass="5" diaginertia=".1 .1 .1"/>')
        lines += [
            f'<joint name="base_{name}" type="{kind}" axis="{axis}"/>'
            for name, kind, axis in (
                ("x", "slide", "1 0 0"), ("y", "slide", "0 1 0"),
                ("roll", "hinge", "1 0 0"), ("pitch", "hinge", "0 1 0"),
            )
        ]  # fmt: skip
    outer = 0
    at = np.zeros(3)
    for i in range(arm.joints):
        axis = _text(arm.axes[i])
        lines.append(f'<body name="link{i + 1}" pos="{_text(at)}">')
        lines.append(
            f'<joint name="joint{i + 1}" axis="{axis}" armature="{arm.armature[i]:.10g}" '
            f'damping="{arm.damping[i]:.10g}"/>'
        )
        if extras.gears:
            inside = 0.05 * arm.armature[i]  # of the gear itself: play behind it needs some
            lines.append(f'<joint name="gear{i + 1}" axis="{axis}" armature="{inside:.8g}"/>')
        if fault is not None and fault.link == i:
            kind = "slide" if fault.kind == "structural_looseness" else "hinge"
            width = fault.gap / 10
            lines.append(
                f'<joint name="seat" type="{kind}" axis="{_text(np.array(fault.direction))}" '
                f'limited="true" range="{-fault.gap / 2:.10g} {fault.gap / 2:.10g}" '
                f'solreflimit="{fault.stop:.8g} 0.6" solimplimit="0.95 0.99 {width:.8g}" '
                f'frictionloss="{fault.friction:.8g}"/>'
            )
        if i in extras.bent:
            split = 0.3 * arm.ends[i]
            lines.append(_inertial(arm, i, 0.3, np.zeros(3)))
            across = np.cross(arm.ends[i], [0.3, 0.5, 0.7])
            lines.append(f'<body name="outer{i + 1}" pos="{_text(split)}">')
            lines.append(
                f'<joint name="bend{i + 1}" axis="{_text(across / np.linalg.norm(across))}"/>'
            )
            lines.append(_inertial(arm, i, 0.7, split))
            at = arm.ends[i] - split
            outer += 1
        else:
            lines.append(_inertial(arm, i, 1.0, np.zeros(3)))
            at = arm.ends[i]
    tool = arm.tool - arm.ends[-1] + at
    lines.append(f'<site name="tool" pos="{_text(tool)}"/>')
    lines += ["</body>"] * (arm.joints + outer + extras.base)
    drives = [f'<motor joint="joint{i + 1}"/>' for i in range(arm.joints)]
    sensors = ['<accelerometer site="tool"/>']
    sensors += [f'<jointpos joint="joint{i + 1}"/>' for i in range(arm.joints)]
    if fault is not None:
        sensors.append('<jointpos joint="seat"/>')
    return _model(STEP, lines, drives, sensors)


def _model(step: float, bodies: list[str], drives: list[str], sensors: list[str]) -> str:
    inside = "\n".join(bodies)
    return (
        '<mujoco model="arm">\n<compiler angle="radian" autolimits="true"/>\n'
        f'<option timestep="{step:.10g}" integrator="implicitfast" jacobian="dense" '
        f'gravity="0 0 {-GRAVITY}"/>\n<worldbody>\n{inside}\n</worldbody>\n'
        "<actuator>\n" + "\n".join(drives) + "\n</actuator>\n"
        "<sensor>\n" + "\n".join(sensors) + "\n</sensor>\n</mujoco>\n"
    )


def _body(arm: Arm, i: int) -> str:
    at = np.zeros(3) if i == 0 else arm.ends[i - 1]
    return f'<body name="link{i + 1}" pos="{_text(at)}">'


def _inertial(arm: Arm, i: int, share: float, origin: Array) -> str:
    """Inertia of a link, or of its inner 30 % or outer 70 % about an origin of its own."""
    centre = arm.centres[i]
    if share < 0.5:
        centre = 0.15 * arm.ends[i]
    elif share < 1.0:
        centre = (arm.centres[i] - 0.3 * 0.15 * arm.ends[i]) / 0.7 - origin
    inertia = arm.inertias[i] * (share if share == 1.0 else share**2)
    return (
        f'<inertial pos="{_text(centre)}" mass="{share * arm.masses[i]:.10g}" '
        f'diaginertia="{_text(inertia)}"/>'
    )


def _inertia(model: mujoco.MjModel, data: mujoco.MjData) -> Array:
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    return full


def _text(values: Array) -> str:
    return " ".join(f"{v:.10g}" for v in values)
