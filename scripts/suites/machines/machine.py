"""A true machine: a random arm in plain MuJoCo under a sampled servo loop, with disturbances."""

from __future__ import annotations

import dataclasses
from collections import deque
from collections.abc import Mapping
from types import MappingProxyType

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
    """MJCF of the machine: torque motors, extra joints without their stiffness yet."""
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


PRESENT = 0.4
"""Probability that a disturbance is present in a case."""
STRONG = 0.75
"""Place within its range of a disturbance that is played alone."""

WEAK_IS_HIGH = frozenset({"rate", "cutoff", "mode", "bandwidth", "bits", "speed", "ratio"})
"""Parameters of which low values disturb most."""


@dataclasses.dataclass(frozen=True)
class Range:
    """Range of a parameter, log-uniform."""

    low: float
    high: float
    unit: str


@dataclasses.dataclass(frozen=True)
class Kind:
    """A disturbance and the ranges of its parameters."""

    title: str
    parameters: Mapping[str, Range]
    present: float = PRESENT


KINDS: Mapping[str, Kind] = MappingProxyType(
    {
        "parameter_errors": Kind(
            "masses, centres, inertias, rotors off (lengths a fifteenth, damping five times that)",
            {"relative": Range(0.02, 0.04, "relative standard deviation")},
            1.0,
        ),
        "coulomb_friction": Kind(
            "Coulomb friction of the joints",
            {"share": Range(0.005, 0.03, "of peak torque")},
        ),
        "stribeck_friction": Kind(
            "larger friction at low speed",
            {
                "excess": Range(0.2, 0.8, "of Coulomb friction"),
                "speed": Range(0.005, 0.05, "rad/s"),
            },
        ),
        "load_friction": Kind(
            "friction that grows with load",
            {"share": Range(0.02, 0.1, "of drive torque")},
        ),
        "sampled_servo": Kind(
            "servo that samples, with a delay of whole samples",
            {"rate": Range(500.0, 8000.0, "Hz"), "delay": Range(0.5, 3.49, "samples")},
        ),
        "velocity_filter": Kind(
            "low-pass on the servo's velocity", {"cutoff": Range(60.0, 300.0, "Hz")}
        ),
        "servo_gains": Kind(
            "gains of the servos, or torque constants, off",
            {"relative": Range(0.05, 0.25, "relative, at most")},
        ),
        "torque_saturation": Kind(
            "drives that saturate early", {"share": Range(0.35, 0.8, "of peak torque")}
        ),
        "flexible_joints": Kind(
            "springs between motors and links",
            {"mode": Range(40.0, 300.0, "Hz"), "ratio": Range(0.01, 0.05, "damping ratio")},
        ),
        "flexible_links": Kind(
            "one or two links that bend",
            {"mode": Range(40.0, 300.0, "Hz"), "ratio": Range(0.005, 0.03, "damping ratio")},
        ),
        "compliant_base": Kind(
            "base that slides and rocks",
            {"mode": Range(30.0, 200.0, "Hz"), "ratio": Range(0.01, 0.05, "damping ratio")},
        ),
        "cables": Kind(
            "springs and dampers of cables at the joints",
            {
                "stiffness": Range(0.005, 0.05, "of peak torque per rad"),
                "damping": Range(0.001, 0.01, "of peak torque per rad/s"),
            },
        ),
        "tool_offset": Kind("accelerometer off its place", {"offset": Range(0.001, 0.005, "m")}),
        "accelerometer_rotation": Kind(
            "accelerometer turned", {"angle": Range(0.5, 2.0, "degrees")}
        ),
        "cross_axis": Kind(
            "axes of the accelerometer that leak into each other",
            {"share": Range(0.01, 0.03, "at most")},
        ),
        "accelerometer_filter": Kind(
            "analogue low-pass of second order in the accelerometer",
            {"bandwidth": Range(120.0, 1000.0, "Hz")},
        ),
        "accelerometer_delay": Kind("late accelerometer", {"delay": Range(1e-4, 1e-3, "s")}),
        "clock_offset": Kind(
            "accelerometer's clock off the controller's", {"offset": Range(5e-4, 5e-3, "s")}, 0.33
        ),
        "clock_drift": Kind(
            "clocks of recorders that drift apart", {"drift": Range(20.0, 300.0, "ppm")}
        ),
        "encoder_quantisation": Kind(
            "encoders with few bits a turn; the servo's own, behind the gear, have four more",
            {"bits": Range(12.0, 20.0, "bits")},
        ),
        "accelerometer_noise": Kind(
            "noise of the accelerometer, 20 where absent", {"density": Range(20.0, 300.0, "µg/√Hz")}
        ),
        "pose_repeat": Kind("poses not quite repeated", {"error": Range(5e-4, 0.01, "rad")}),
        "friction_drift": Kind(
            "friction and damping that change between sessions",
            {"relative": Range(0.1, 0.4, "relative, at most")},
        ),
    }
)
"""Name -> disturbance."""


@dataclasses.dataclass(frozen=True)
class Disturbances:
    """Disturbances of a machine and their sizes."""

    sizes: Mapping[str, Mapping[str, float]]
    """Name -> parameter -> value; those that are absent are not there."""

    @classmethod
    def none(cls) -> Disturbances:
        """Return a machine that is its model."""
        return cls({})

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Disturbances:
        """Draw each disturbance by its probability, its sizes log-uniform."""
        sizes = {}
        for name, kind in KINDS.items():
            there = rng.random() < kind.present
            values = {
                key: float(np.exp(rng.uniform(np.log(r.low), np.log(r.high))))
                for key, r in kind.parameters.items()
            }
            if there:
                sizes[name] = values
        return cls(sizes)

    @classmethod
    def only(cls, name: str, share: float = STRONG) -> Disturbances:
        """One disturbance alone, strong by default."""
        sizes = {}
        for key, r in KINDS[name].parameters.items():
            weak_is_high = key in WEAK_IS_HIGH or name == "torque_saturation"
            place = 1 - share if weak_is_high else share
            sizes[key] = float(r.low * (r.high / r.low) ** place)
        return cls({name: sizes})

    def has(self, name: str) -> bool:
        """Return True if a disturbance is present."""
        return name in self.sizes

    def size(self, name: str, parameter: str, absent: float = 0.0) -> float:
        """Value of a parameter, or ``absent`` where the disturbance is not there."""
        if parameter not in KINDS[name].parameters:
            raise KeyError(f"{name} has no parameter {parameter!r}")
        return self.sizes[name][parameter] if name in self.sizes else absent


MOST_TURNED = 0.1
"""Departure of a joint from its pose above which a run is unstable [rad]."""
MOST_CHATTER = 0.05
"""Rms torque of a servo at rest over the limit, above which its loop is unstable."""
LOOK = 64
"""Steps between looks at the pose."""


class Unstable(Exception):
    """The servo loop does not hold the pose."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Servo:
    """What the controller of the machine does."""

    every: int
    """Integration steps between its samples."""
    delay: int
    """Samples from reading to torque."""
    smoothing: float
    """Share of a new velocity in the filtered one."""
    kp: Array
    """True stiffness [N m/rad] (n,)."""
    kv: Array
    """True damping [N m s/rad] (n,)."""
    constant: Array
    """True over nominal torque constant (n,)."""
    limit: Array
    """Torque at which the drives saturate [N m] (n,)."""
    resolution: float
    """Step of the servo's encoders [rad], 0 for exact ones."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Played:
    """True motion in a run, at the integration step."""

    acceleration: Array
    """Proper acceleration of the tool [m/s²] (T, 3)."""
    position: Array
    """Angles at the encoders [rad] (T, n)."""
    velocity: Array
    """The servo's estimate of speed [rad/s] (T, n)."""
    torque: Array
    """Torque that the controller asks for [N m] (T, n)."""
    seat: Array
    """Motion in the loose seat [m, rad] (T,); zeros where there is none."""


class Machine:
    """The arm as it is."""

    def __init__(
        self, nominal: Arm, disturbances: Disturbances, fault: Fault | None, seed: list[int]
    ) -> None:
        rng = np.random.default_rng(np.random.SeedSequence(seed))
        n = nominal.joints
        self.nominal, self.fault, self.disturbances = nominal, fault, disturbances
        size = disturbances.size
        arm = altered(nominal, size("parameter_errors", "relative"), rng)
        sign = rng.normal(size=3)
        offset = size("tool_offset", "offset") * sign / np.linalg.norm(sign)
        arm = dataclasses.replace(arm, tool=arm.tool + offset)
        spread = rng.uniform(0.7, 1.3, (8, n))
        bent: tuple[int, ...] = tuple(int(i) for i in rng.permutation(n)[: rng.integers(1, 3)])
        if not disturbances.has("flexible_links"):
            bent = ()
        extras = Extras(
            gears=disturbances.has("flexible_joints"),
            bent=bent,
            base=disturbances.has("compliant_base"),
            fault=fault,
        )
        self.arm = arm
        self.model = mujoco.MjModel.from_xml_string(true_xml(arm, extras))
        model = self.model
        model.dof_solref[:] = [0.002, 1.0]
        model.dof_solimp[:, :2] = 0.99
        motors = [model.joint(f"joint{i + 1}") for i in range(n)]
        self.motor_q = np.array([j.qposadr[0] for j in motors])
        self.motor_v = np.array([j.dofadr[0] for j in motors])
        self._springs(spread)
        if disturbances.has("cables"):
            model.jnt_stiffness[[j.id for j in motors]] = (
                size("cables", "stiffness") * arm.limit * spread[3]
            )
            model.qpos_spring[self.motor_q] = rng.uniform(-1, 1, n)
            model.dof_damping[self.motor_v] += size("cables", "damping") * arm.limit * spread[4]
        self.damping = model.dof_damping[self.motor_v].copy()
        coulomb = size("coulomb_friction", "share")
        if disturbances.has("stribeck_friction"):
            coulomb = max(coulomb, 0.005)
        self.coulomb = coulomb * arm.limit * spread[5]
        self.servo = self._servo(rng, spread)

    def _springs(self, spread: Array) -> None:
        """Give the extra joints stiffness and damping by their modes."""
        model, size = self.model, self.disturbances.size
        data = mujoco.MjData(model)
        data.qpos[self.motor_q] = 0.7
        mujoco.mj_forward(model, data)
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, full)
        groups = {"gear": "flexible_joints", "bend": "flexible_links", "base": "compliant_base"}
        for j in range(model.njnt):
            name, dof = model.joint(j).name, model.jnt_dofadr[j]
            for prefix, kind in groups.items():
                if name.startswith(prefix):
                    factor = spread[len(prefix) % 3, j % spread.shape[1]]
                    omega = 2 * np.pi * size(kind, "mode") * factor
                    inertia = full[dof, dof]
                    model.jnt_stiffness[j] = inertia * omega**2
                    model.dof_damping[dof] = 2 * size(kind, "ratio") * inertia * omega

    def _servo(self, rng: np.random.Generator, spread: Array) -> Servo:
        nominal, size, n = self.nominal, self.disturbances.size, self.nominal.joints
        wanted = size("sampled_servo", "rate", 1 / STEP)
        every = max(2 ** round(np.log2(1 / STEP / wanted)), 2)
        bits = size("encoder_quantisation", "bits")
        cutoff = size("velocity_filter", "cutoff", 400.0 if bits else np.inf)
        off = size("servo_gains", "relative")
        errors = 1 + off * rng.uniform(-1, 1, (3, n))
        position = nominal.servoed
        return Servo(
            every=every,
            delay=round(size("sampled_servo", "delay")),
            smoothing=float(1 - np.exp(-2 * np.pi * cutoff * every * STEP)),
            kp=nominal.kp * (errors[0] if position else 1.0),
            kv=nominal.kv * (errors[1] if position else 1.0),
            constant=np.ones(n) if position else 1 + (errors[2] - 1) / 2,
            limit=nominal.limit * size("torque_saturation", "share", 1.0),
            resolution=2 * np.pi / 2 ** (round(bits) + 4) if bits else 0.0,
        )

    def play(
        self, pose: Array, hold: Array, shaken: Array, joint: int, settle: int, friction: float
    ) -> Played:
        """Hold a pose and shake a joint."""
        model, servo, n = self.model, self.servo, self.nominal.joints
        data = mujoco.MjData(model)
        self._rest(data, pose, friction)
        steps = len(shaken)
        width = model.nsensordata
        read, told = np.zeros((steps, width)), np.zeros((steps, n))
        speed = np.zeros((steps, n))
        limit, kp, kv = servo.limit, servo.kp, servo.kv
        position = self.nominal.servoed
        coulomb = friction * self.coulomb
        excess = self.disturbances.size("stribeck_friction", "excess")
        slow = self.disturbances.size("stribeck_friction", "speed", 1.0)
        load = friction * self.disturbances.size("load_friction", "share")
        varying = excess > 0 or load > 0
        command = np.array(hold if position else pose, dtype=float)
        rest = np.zeros(n) if position else np.array(hold)
        waiting = deque([np.array(rest if not position else data.ctrl)] * servo.delay)
        measured = self._measured(data)
        before, velocity = measured, np.zeros(n)
        per_second = 1 / (servo.every * STEP)
        torque = np.zeros(n)
        addresses = self.motor_v
        step = mujoco.mj_step
        target = command.copy()
        for k in range(steps):
            if k % servo.every == 0:
                measured = self._measured(data)
                velocity = velocity + servo.smoothing * (
                    (measured - before) * per_second - velocity
                )
                before = measured
                if position:
                    target[joint] = command[joint] + shaken[k]
                torque = kp * (target - measured) - kv * velocity + rest
                if not position:
                    torque[joint] += shaken[k]
                torque = np.minimum(np.maximum(torque, -limit), limit)
                waiting.append(torque)
                data.ctrl[:] = servo.constant * waiting.popleft()
                if varying:
                    true = data.qvel[addresses]
                    loss = coulomb * (1 + excess * np.exp(-((true / slow) ** 2)))
                    model.dof_frictionloss[addresses] = loss + load * np.abs(data.ctrl)
            if k % LOOK == 0 and not np.abs(data.qpos[self.motor_q] - pose).max() < MOST_TURNED:
                raise Unstable(f"a joint left its pose by more than {MOST_TURNED:g} rad")
            step(model, data)
            read[k] = data.sensordata
            told[k] = torque
            speed[k] = velocity
        played = Played(
            acceleration=read[:, :3],
            position=read[:, 3 : 3 + n],
            velocity=speed,
            torque=told,
            seat=read[:, 3 + n] if self.fault is not None else np.zeros(steps),
        )
        self._check(played, pose, settle)
        return played

    def lever(self, pose: Array) -> float:
        """Motion of the tool per motion in the loose seat [1, m/rad]."""
        data = mujoco.MjData(self.model)
        data.qpos[self.motor_q] = pose
        mujoco.mj_forward(self.model, data)
        jacobian = np.zeros((3, self.model.nv))
        mujoco.mj_jacSite(self.model, data, jacobian, None, self.model.site("tool").id)
        return float(np.linalg.norm(jacobian[:, self.model.joint("seat").dofadr[0]]))

    def _measured(self, data: mujoco.MjData) -> Array:
        q: Array = data.qpos[self.motor_q]
        if self.servo.resolution:
            return np.round(q / self.servo.resolution) * self.servo.resolution
        return q

    def _rest(self, data: mujoco.MjData, pose: Array, friction: float) -> None:
        """Set the pose, springs bent by the arm's weight."""
        model = self.model
        model.dof_frictionloss[self.motor_v] = friction * self.coulomb
        model.dof_damping[self.motor_v] = friction * self.damping
        data.qpos[self.motor_q] = pose
        mujoco.mj_forward(model, data)
        for j in range(model.njnt):
            name = model.joint(j).name
            if not name.startswith(("joint", "seat")):
                dof = model.jnt_dofadr[j]
                data.qpos[model.jnt_qposadr[j]] = -data.qfrc_bias[dof] / model.jnt_stiffness[j]
        data.ctrl[:] = data.qfrc_bias[self.motor_v] / self.servo.constant

    def _check(self, played: Played, pose: Array, settle: int) -> None:
        everything = np.isfinite(played.acceleration).all()
        turned = np.abs(played.position - pose).max() if everything else np.inf
        if not turned < MOST_TURNED:
            raise Unstable(f"a joint left its pose by {turned:.3g} rad")
        still = played.torque[settle // 2 : settle]
        chatter = (still.std(axis=0) / self.nominal.limit).max()
        if chatter > MOST_CHATTER:
            raise Unstable(f"a servo at rest asks for {chatter:.0%} of its limit")
