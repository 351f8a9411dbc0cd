"""Joints of a model, the columns that belong to each, and the units of their channels.

Every way to read a vector of positions (radians, degrees, shares of the limits, ticks) gets a score
against it, the sum over its joints of

    2 + 2 log(share) where values are outside the limits, else min(2, log(share / 0.5)² / 3),
    share = largest value / largest limit,

and what a velocity beside contradicts; the least is taken. Far below a limit speaks against a unit
too, but never by more than a joint at rest is worth.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import mujoco
import numpy as np

from loose_env.importing.evidence import Agreement, Signal, sensed_in
from loose_env.importing.names import Role
from loose_env.importing.resampling import smoothed
from loose_env.importing.units import nearest_unit, quantity_of, unit_named
from loose_env.recording import ModelColumns, joint_sensors
from loose_env.sensors import STANDARD_GRAVITY
from loose_env.typing import Array

SMOOTHED = 9
"""Samples over which positions are averaged before they are differentiated twice."""
Quantity = Literal["position", "velocity", "torque"]
"""Quantity that an actuator's command sets."""


@dataclass(frozen=True, kw_only=True)
class Drive:
    """Actuator at a joint or tendon by its force: gain · command + bias · (1, position, speed)."""

    name: str
    number: int
    """Among the actuators of the model."""
    joints: tuple[str, ...]
    """The joint that it drives, or those of its tendon."""
    tendon: str
    sets: Quantity
    gear: float
    """Joint torque over actuator force [1]."""
    gain: float
    """Actuator force over command, after its filter; 0 where it is not constant."""
    filter_s: float
    """Time constant of a filter on its command [s]; 0 without."""
    bias: tuple[float, float, float]
    integrates: bool
    """Whether its command is the rate of what it follows."""
    lag: float
    """Delay of slow motion behind the command of a position drive in the model [s]."""
    unit: str
    """Unit of the force at the joint."""
    limits: tuple[float, float] | None
    """Limits of the command; None where it has none."""

    @property
    def joint(self) -> str:
        """The joint that it drives, or the first of its tendon."""
        return self.joints[0]

    @property
    def follows(self) -> bool:
        """True for a position servo, which rests where its command is."""
        return self.gain > 0 and bool(np.isclose(self.bias[1], -self.gain))

    @property
    def motor(self) -> bool:
        """True if its force is the gain times the command, whatever the motion."""
        return bool(self.gain) and not self.filter_s and not any(self.bias)

    @property
    def words(self) -> str:
        """The drive as a person is told of it."""
        turn = "rad" if self.unit == "N·m" else "m"
        per = {"position": f"/{turn}", "velocity": f"·s/{turn}", "torque": " per unit of command"}
        size = max(self.gain, -self.bias[2]) if self.sets == "velocity" else self.gain
        stiff = -self.bias[1] if self.integrates else size
        unit = f"{self.unit}{per['position' if self.integrates else self.sets]}"
        kind = {"position": "position drive", "velocity": "velocity drive", "torque": "motor"}
        law = f"{stiff * self.gear ** (1 + (self.sets != 'torque')):.3g} {unit}"
        law = law if self.gain or self.integrates else "a force that is not linear in its command"
        where = " and ".join(self.joints) + (f" by tendon {self.tendon}" if self.tendon else "")
        late = ", which integrates its command" if self.integrates else ""
        late = f", through a filter of {self.filter_s:.3g} s" if self.filter_s else late
        return f"{self.name}: {kind[self.sets]} of {where}, {law}{late}"


_FILTERS = (int(mujoco.mjtDyn.mjDYN_FILTER), int(mujoco.mjtDyn.mjDYN_FILTEREXACT))


def drives_of(model: mujoco.MjModel) -> list[Drive]:
    """Actuators of one command at a joint or a fixed tendon, in the model's order.

    Examples
    --------
    >>> xml = '''<mujoco><worldbody><body><joint name="turn"/><geom size=".1"/></body></worldbody>
    ... <actuator><velocity name="spin" joint="turn" kv="20"/></actuator></mujoco>'''
    >>> drives_of(mujoco.MjModel.from_xml_string(xml))[0].words
    'spin: velocity drive of turn, 20 N·m·s/rad'
    """
    found = []
    kinds = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
    for a in range(model.nu):
        own, at = model.actuator(a), int(model.actuator_trnid[a, 0])
        joints, tendon = [at], ""
        if int(model.actuator_trntype[a]) == int(mujoco.mjtTrn.mjTRN_TENDON):
            parts = slice(model.tendon_adr[at], model.tendon_adr[at] + model.tendon_num[at])
            fixed = np.all(model.wrap_type[parts] == int(mujoco.mjtWrap.mjWRAP_JOINT))
            joints, tendon = model.wrap_objid[parts].tolist() * bool(fixed), model.tendon(at).name
        elif int(model.actuator_trntype[a]) not in kinds:
            continue
        if not joints or model.actuator_ctrlnum[a] != 1:
            continue
        bias = np.where(own.biastype == mujoco.mjtBias.mjBIAS_AFFINE, own.biasprm[:3], 0.0)
        integrates = bool(own.dyntype[0] == mujoco.mjtDyn.mjDYN_INTEGRATOR and bias[1])
        filter_s = float(own.dynprm[0]) * (int(own.dyntype[0]) in _FILTERS)
        linear = own.gaintype[0] == mujoco.mjtGain.mjGAIN_FIXED and (
            own.dyntype[0] == mujoco.mjtDyn.mjDYN_NONE or int(own.dyntype[0]) in _FILTERS
        )
        gear, gain = float(own.gear[0]), float(own.gainprm[0]) * bool(linear)
        damping = float(model.dof_damping[model.jnt_dofadr[joints[0]]]) - bias[2] * gear**2
        sets: Quantity = "velocity" if integrates else (
            "position" if bias[1] else "velocity" if bias[2] and gain else "torque")  # fmt: skip
        slides = model.jnt_type[joints[0]] == mujoco.mjtJoint.mjJNT_SLIDE
        found.append(Drive(
            name=own.name, number=a, joints=tuple(model.joint(j).name for j in joints),
            sets=sets, gear=gear, gain=gain, filter_s=filter_s, bias=tuple(bias.tolist()),
            tendon=tendon, integrates=integrates,
            lag=float(damping / (gain * gear**2)) + filter_s if gain and gear else 0.0,
            unit="N" if slides else "N·m",
            limits=tuple(own.ctrlrange.tolist()) if own.ctrllimited[0] else None,
        ))  # fmt: skip
    return found


@dataclass(frozen=True, kw_only=True)
class JointTarget:
    """A joint, and the columns of a recording that belong to it; "" where the model has none."""

    name: str
    slide: bool
    limits: tuple[float, float] | None
    """Limits of its position [rad or m]."""
    position: str
    velocity: str
    torque: str
    command: str
    drive: Quantity
    aliases: tuple[str, ...]
    """Names that a channel may call it by: its own, and those of its drive and sensors."""

    @property
    def columns(self) -> tuple[str, str, str, str]:
        """All of its columns."""
        return self.position, self.velocity, self.torque, self.command


def joint_targets(model: mujoco.MjModel) -> list[JointTarget]:
    """List the joints with one coordinate and a name, in the model's order."""
    known = ModelColumns.of(model).known
    found, drives = [], drives_of(model)
    for name, sensors in joint_sensors(model).items():
        joint = model.joint(name).id
        low, high = map(float, model.jnt_range[joint])
        own = [d for d in drives if name == d.joint]
        drive, kind = (own[0].name, own[0].sets) if len(own) == 1 else ("", "torque")
        columns = {
            "position": f"sensor.{sensors.position[0]}" if sensors.position else "",
            "velocity": f"sensor.{sensors.velocity[0]}" if sensors.velocity else "",
            "torque": f"torque.{name}",
            "command": f"ctrl.{drive}",
        }
        found.append(
            JointTarget(
                name=name,
                slide=model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE,
                limits=(low, high) if model.jnt_limited[joint] else None,
                drive=kind,
                aliases=(name, *filter(None, [drive, *sensors.position, *sensors.velocity])),
                **{role: column * (column in known) for role, column in columns.items()},
            )
        )
    return found


def vector_orders(model: mujoco.MjModel) -> list[list[str]]:
    """Joints of the entries of a vector, "" for none: all of them, and MuJoCo's own arrays.

    Examples
    --------
    >>> xml = '''<mujoco><worldbody><body><freejoint/><geom size=".1"/><body><joint name="turn"/>
    ... <geom size=".1"/></body></body></worldbody></mujoco>'''
    >>> vector_orders(mujoco.MjModel.from_xml_string(xml))[3]
    ['', '', '', '', '', '', 'turn']
    """
    single = [t.name for t in joint_targets(model)]
    drives = {drive.number: drive.joint for drive in drives_of(model)}
    orders = [single, [drives.get(a, "") for a in range(model.nu)]]
    for count, places in ((model.nq, model.jnt_qposadr), (model.nv, model.jnt_dofadr)):
        order = [""] * count
        for name in single:
            order[int(places[model.joint(name).id])] = name
        orders.append(order)
    return orders


_GRAVITY = 0.2
"""Share by which the mean over a second of an accelerometer may be off 1 g, where no name tells
it [1]."""
_TOOLS = (
    (mujoco.mjtSensor.mjSENS_ACCELEROMETER, "acceleration", ("m/s^2", "g", "mg"),
     {"a", "acc", "accel", "acceleration", "accelerometer"}),
    (mujoco.mjtSensor.mjSENS_GYRO, "angular speed", ("rad/s", "deg/s"),
     {"g", "gyro", "gyr", "gyroscope", "angular", "omega"}),
)  # fmt: skip


class Tool(NamedTuple):
    """The model's only sensor of a kind, and the channels of its axes."""

    name: str
    quantity: str
    axes: dict[int, Signal]
    """By their places, 0 for x; one may be missing."""
    agreement: Agreement
    """With what the model reads there; zeros where that is not known."""
    scaling: Scaling
    """Without a unit where neither the file nor the motion tells it."""
    fits: bool


def tool_sensors(
    model: mujoco.MjModel, free: Sequence[Signal], felt: Sequence[Array], told: float, untold: float
) -> Iterator[Tool]:
    """Channels that the model's only accelerometer and gyro would read, by the readings ``felt``.

    Three channels whose names differ in their axis are taken where name or unit tells the
    quantity, and they agree by ``told`` or gravity is in them; others where as many in a row agree
    by ``untold``, as the model mounts the sensor. An accelerometer's unit is the one in which its
    mean over a second is 1 g; that of a gyro follows from the motion.
    """
    groups: dict[object, dict[str, Signal]] = {}
    for s in free:
        stem, axis = s.meaning.axis
        groups.setdefault((s.source, s.key.topic, stem), {}).setdefault(axis, s)
    named = []
    for group in groups.values():
        keys = sorted(group, key=lambda k: (len(k), k))
        if (lettered := set(keys) <= {*"xyz"}) or len(keys) == 3:
            places = map("xyz".index, keys) if lettered else range(3)
            named.append(dict(zip(places, map(group.__getitem__, keys), strict=True)))
    rest = [s for s in free if untold < 1 and not s.unit and s.meaning.role in ("", "acceleration")]
    rows = [dict(enumerate(own)) for own in zip(rest, rest[1:], rest[2:], strict=False)]
    for kind, quantity, units, words in _TOOLS:
        others = set().union(*(each for *_, each in _TOOLS)) - words
        ids = np.flatnonzero(model.sensor_type == kind)
        found: list[tuple[float, Tool]] = []
        for own in (*named, *rows) if len(ids) == 1 else ():
            signals = [*own.values()]
            if len({(s.source, len(s.values)) for s in signals}) != 1 or len(own) < 2:
                continue
            at = int(model.sensor_adr[ids[0]])
            read = [[v[:, at + i] for v in felt] for i in range(3)]
            like = sensed_in(own, [s.smooth for s in signals], read) if felt else Agreement()
            still = np.linalg.norm([s.averaged(1.0) for s in signals], axis=0)
            heavy = nearest_unit(float(np.median(still)) / STANDARD_GRAVITY, units)
            weighs = quantity == "acceleration" and len(own) == 3 and heavy[1] < _GRAVITY
            stems = [set(s.meaning.axis[0]) for s in signals]
            stated = {quantity_of(s.unit) for s in signals}
            called = all(stem & words for stem in stems) or stated == {quantity}
            # A file's name may be all that says acceleration: then gravity has to be in it.
            plain = all(s.meaning.role == "acceleration" for s in signals)
            beside = weighs and plain and not any(stem & others for stem in stems)
            agrees = not felt or quantity == "acceleration" or like.whole >= told
            sure = len(own) == 3 and all(s in rest for s in signals) and (
                like.alone >= untold or (own in named and like.whole >= untold))  # fmt: skip
            if stated <= {"", quantity} and (called or beside or sure):
                unit = signals[0].unit or heavy[0] * weighs or units[0] * signals[0].defined
                scaling = (
                    Scaling(unit)
                    if unit or not like.per
                    else (
                        by_motion(like.per, units)
                        or Scaling(units[0], like.per, reason="in no unit: scaled by the motion")
                    )
                )
                name = model.sensor(int(ids[0])).name
                tool = Tool(name, quantity, own, like, scaling, sure or agrees)
                found.append((tool.fits + called + like.whole, tool))
        if found:
            yield max(found, key=lambda each: each[0])[1]


def inverse_dynamics(
    model: mujoco.MjModel, qpos: Array, qvel: Array, qacc: Array, readings: Array | None = None
) -> Array:
    """Generalised force that a motion needs, shape (T, nv); sensor data go to ``readings``.

    Contacts, stops and friction are left out: they change neither kinematics nor what gravity and
    inertia need.
    """
    data, flags = mujoco.MjData(model), model.opt.disableflags
    torques = np.zeros((len(qpos), model.nv))
    try:
        model.opt.disableflags = flags | int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        for row in range(len(qpos)):
            data.qpos[:], data.qvel[:], data.qacc[:] = qpos[row], qvel[row], qacc[row]
            mujoco.mj_inverse(model, data)
            torques[row] = data.qfrc_inverse
            if readings is not None:
                readings[row] = data.sensordata
    finally:
        model.opt.disableflags = flags
    return torques


def couplings_of(model: mujoco.MjModel) -> dict[str, tuple[int, Array]] | None:
    """Leader of each joint that follows another, -1 for none, and its polynomial (5,).

    None where other equality constraints are active, which close loops.
    """
    active = [int(i) for i in np.flatnonzero(model.eq_active0)]
    if any(int(model.eq_type[i]) != int(mujoco.mjtEq.mjEQ_JOINT) for i in active):
        return None
    pairs = {i: (int(model.eq_obj1id[i]), int(model.eq_obj2id[i])) for i in active}
    return {model.joint(one).name: (two, model.eq_data[i, :5]) for i, (one, two) in pairs.items()}


def followers(model: mujoco.MjModel) -> list[str]:
    """Joints that follow others, in words."""
    return [
        f"joint {joint} follows {model.joint(leader).name if leader >= 0 else 'a constant'}"
        for joint, (leader, _) in (couplings_of(model) or {}).items()
    ]


def needed_torques(
    model: mujoco.MjModel, joints: Mapping[str, Sequence[Array]], step: float, every: int = 1,
    readings: list[Array] | None = None,
) -> dict[str, list[Array]]:  # fmt: skip
    """Torques that the model needs for a measured motion [N·m or N], by joint and run.

    Those of each so many rows, where ``every`` is more than 1; ``readings`` takes the sensor data.

    Positions are averaged over nine samples before they are differentiated. Joints that follow
    another by an equality move with it. Empty where the motion of a joint is not known, or where
    loops are closed, whose forces are not unique.
    """
    if model.nq != model.nv or model.nv == 0 or not joints:
        return {}
    couplings = couplings_of(model)
    if couplings is None:
        return {}
    names = [model.joint(j).name for j in range(model.njnt)]
    if not set(names) - set(couplings) <= set(joints):
        return {}
    runs = len(next(iter(joints.values())))
    found: dict[str, list[Array]] = {name: [] for name in names}
    for run in range(runs):
        length = max((len(own[run]) for own in joints.values()), default=0)
        position = np.zeros((length, model.nq))
        for j, name in enumerate(names):
            if name in joints and len(joints[name][run]) == length:
                position[:, j] = joints[name][run]
        for name, (leader, poly) in couplings.items():
            if name not in joints:
                x = position[:, leader] if leader >= 0 else np.zeros(length)
                position[:, names.index(name)] = np.polynomial.polynomial.polyval(x, poly)
        torque = np.zeros((len(position[::every]), model.nv))
        felt = np.zeros((len(torque), model.nsensordata))
        if length > 2:
            position = smoothed(position, SMOOTHED)
            velocity = np.gradient(position, step, axis=0)
            change = np.gradient(velocity, step, axis=0)
            position, velocity, change = (v[::every] for v in (position, velocity, change))
            torque = inverse_dynamics(model, position, velocity, change, felt)
        if readings is not None:
            readings.append(felt)
        for j, name in enumerate(names):
            found[name].append(torque[:, j])
    return found


# ------------------------------------------------------------------------- units

_MARGIN = 0.05
"""Part of a joint's range by which a sensor may exceed the limits [1]."""
_TURNS = 20.0
"""Largest position of a joint without limits that is taken for radians where nothing else tells:
three turns each way. A channel that is consistent with a velocity is radians beyond it, too."""
_NORMALISED = 102.0
"""Largest value taken as normalised to 100 [1]: a calibrated end, and a margin."""
_TICKS = 4096
"""Ticks a turn of the servos whose words are logged as they are."""
_NEAR = 1.5
"""Factor within which a ratio of rates counts as that of a unit [1]."""
_AGAINST = {"rad": 0.0, "m": 0.0, "deg": 0.5, "mm": 0.5, "ticks": 0.5, "rev": 2.0,
            "normalised": 2.0}  # fmt: skip
"""What speaks against a unit where values fit: the rarer one."""
_LENGTHS, _ANY = ("m", "mm"), ("normalised", "ticks")
_COUNTS, _DENIED = 0.03, 0.15
"""Logarithms by which counts may be off those of a usual encoder at one joint and at all [1]: a
servo follows slow commands so closely, and where gravity pulls it less."""
_UNFIT = 4.0
"""What a joint whose values no unit of a kind can be speaks against it."""
_DEFINED = 2.0
"""What the definition of a format speaks for radians: less than values far outside the limits."""
RATES, SPEEDS = ("rad/s", "deg/s", "rpm", "rev/s"), ("m/s", "mm/s", "cm/s", "mm/min")
_ALLOWED: dict[str, tuple[str, ...]] = {
    "position": ("angle", "length", "number"),
    "velocity": ("angular speed", "speed"),
    "torque": ("torque", "force", "number", "current"),
    "position drive": ("number", "voltage", "angle", "length"),
    "velocity drive": ("number", "voltage", "angle", "length", "angular speed", "speed"),
    "torque drive": ("number", "voltage", "torque", "force", "current"),
}
"""Role, or kind of drive that is commanded -> quantities of a channel."""
_OF_SLIDES, _OF_HINGES = ("length", "speed", "force"), ("angle", "angular speed", "torque")
_RATE_OF = {"angle": "angular speed", "length": "speed"}


@dataclass(frozen=True)
class Scaling:
    """How a channel's values become SI: unit, factor before it, and offset after it."""

    unit: str
    scale: float = 1.0
    offset: float = 0.0
    """[rad or m]"""
    reason: str = ""
    sign: int = 1

    @property
    def factor(self) -> float:
        """Factor from the channel's values to SI units."""
        return self.sign * self.scale * (unit_named(self.unit, "").factor if self.unit else 1.0)

    def si(self, runs: Sequence[Array]) -> list[Array]:
        """Values of runs in SI units."""
        return [v * self.factor + self.offset for v in runs]


def admits(unit: str, role: Role, *, slide: bool, drive: str = "") -> bool:
    """Return whether a channel with a stated unit may have a role at a joint.

    Examples
    --------
    >>> admits("mm", "position", slide=True), admits("mm", "position", slide=False)
    (True, False)
    """
    quantity = quantity_of(unit)
    allowed = _ALLOWED[f"{drive} drive" if role == "command" else role]
    other = _OF_HINGES if slide else _OF_SLIDES
    return not quantity or (quantity in allowed and quantity not in other)


def is_rate(unit: str, of: str) -> bool:
    """Return whether a channel may be the derivative of another, by their stated units."""
    own, other = quantity_of(unit), quantity_of(of)
    return not own or not other or _RATE_OF.get(other) == own


Told = tuple[float, str]
"""Values of a position per rad or m, as a witness beside it has them, and the witness in words."""


def position_scalings(
    pairs: Mapping[str, tuple[JointTarget, Signal]], told: Mapping[str, Told], defined: bool
) -> dict[str, Scaling | None]:
    """Scaling of the position of each joint, as a witness tells, too; None where none fits."""
    ways = {joint: _ways(*pair, turns=bool(told)) for joint, pair in pairs.items()}
    against: dict[str, float] = {}
    for way, prior in _AGAINST.items():
        alike = [j for j, (t, s) in pairs.items()
                 if not s.unit and (way in _ANY or t.slide == (way in _LENGTHS))]  # fmt: skip
        against[way] = prior - _DEFINED * (defined and way in ("rad", "m")) + sum(
            _against(way, *pairs[j], ways[j][way], told.get(j)) if way in ways[j] else _UNFIT
            for j in alike
        )  # fmt: skip
    return {
        joint: _chosen(*pair, ways[joint], against, told.get(joint), defined)
        for joint, pair in pairs.items()
    }


def _ways(joint: JointTarget, s: Signal, *, turns: bool) -> dict[str, Scaling]:
    """Ways to read the values of a position; turns are rare, and only a speed tells them."""
    if s.unit != "%" and quantity_of(s.unit) not in ("", "number"):
        fits = quantity_of(s.unit) == ("length" if joint.slide else "angle")
        return {"stated": Scaling(s.unit, reason=f"{s.unit} as stated")} if fits else {}
    units = ("m", "mm") if joint.slide else ("rad", "deg", *["rev"] * turns)
    found = {unit: Scaling(unit) for unit in units if s.unit != "%"}
    if joint.limits is not None and max(abs(s.ends)) <= _NORMALISED:
        low, high = joint.limits
        ways = [(-100, (high - low) / 200, (high + low) / 2)]
        ways += [(0, (high - low) / 100, low)] * bool(s.ends[0] >= -1)
        bottom, scale, offset = ways[-1]
        reason = f"normalised to {bottom}..100 of the limits"
        found["normalised"] = Scaling(units[0], scale, offset, reason)
    if s.whole and not joint.slide and s.ends[1] < _TICKS and s.unit != "%":
        zero = 0 if s.ends[0] < 0 else _TICKS // 2
        words = f"ticks of {_TICKS} a turn, {zero} at zero"
        found["ticks"] = Scaling("rad", 2 * math.pi / _TICKS, -math.pi * (zero > 0), words)
    return found


def _against(way: str, joint: JointTarget, s: Signal, scaling: Scaling, told: Told | None) -> float:
    """Score of one joint against a way to read its values."""
    ends = scaling.si([s.ends])[0]
    share = max(float(np.abs(ends).max()), 1e-9) / max(_end(joint), 1e-9)
    if way == "normalised":
        share = max(*np.abs(s.ends), 1e-9) / 100
    if not _within(joint, ends):
        found = 2.0 + 2.0 * math.log(max(share, 1.0))
    else:
        found = 0.0 if joint.limits is None else min(2.0, math.log(share / 0.5) ** 2 / 3)
    return found + (0.0 if told is None else 3 * abs(math.log(scaling.factor * told[0])))


def _end(joint: JointTarget) -> float:
    """Largest position that is expected [rad or m]."""
    return (1.0 if joint.slide else _TURNS) if joint.limits is None else max(map(abs, joint.limits))


def _within(joint: JointTarget, ends: Array, margin: float = _MARGIN) -> bool:
    """Return whether positions lie within a joint's limits, and a share of them beyond."""
    low, high = joint.limits or (-_end(joint), _end(joint))
    margin *= (high - low) * (joint.limits is not None)
    return bool(low - margin <= ends[0] and ends[1] <= high + margin)


def _chosen(
    joint: JointTarget, s: Signal, ways: Mapping[str, Scaling], against: Mapping[str, float],
    told: Told | None, defined: bool,
) -> Scaling | None:  # fmt: skip
    """Scaling of one position: as stated, as its vector's, or its own where that does not fit."""
    unit = "m" if joint.slide else "rad"
    within = {way: _within(joint, scaling.si([s.ends])[0]) for way, scaling in ways.items()}

    def fits(way: str) -> bool:
        return told is not None or (defined and way == unit) or within[way]

    best = min(ways, key=lambda way: against.get(way, 0.0), default="")
    near = best in ("", "stated") or fits(best) or _within(joint, ways[best].si([s.ends])[0], 0.5)
    if not near:
        own = {w: _AGAINST[w] + _against(w, joint, s, ways[w], told) for w in ways if fits(w)}
        best = min(own, key=lambda way: own[way], default="")
    if not best:
        return None
    limits = joint.limits
    about = "no limits in the model" if limits is None else (
        f"limits {limits[0]:.4g} to {limits[1]:.4g} {unit}")  # fmt: skip
    why = ways[best].reason or ways[best].unit
    if best != "stated":
        why = (
            f"{unit} as the format defines"
            if defined and best == unit
            else told[1]
            if told
            else why
        )
    reason = f"{why}; values {s.ends[0]:.4g} to {s.ends[1]:.4g}, {about}"
    reason += "" if within[best] or (limits is None and best != "stated") else ", which they exceed"
    if best == "deg" and "normalised" in ways:
        reason += "; values normalised to -100..100 would look alike"
    return replace(ways[best], reason=reason)


def counted(pers: Sequence[float], slide: bool) -> tuple[str, float]:
    """Usual counts of encoders, and one of them [rad or m], as one tells and none denies.

    Examples
    --------
    >>> counted([9.4e-5, 1.02e-4], False)[0], counted([1.02e-3], True)[0], counted([5e-4], True)[0]
    ('65536 counts a turn', '1000 counts a metre', '')
    """
    known = {f"{10**k} counts a {'metre' if slide else 'radian'}": 0.1**k for k in range(1, 7)}
    if not slide:
        known |= {f"{10**k} counts a degree": math.pi / 180 * 0.1**k for k in range(5)}
        known |= {f"{2**k} counts a turn": 2 * math.pi / 2**k for k in range(8, 25)}
    off = {
        words: sorted(abs(math.log(max(per, 1e-12) / each)) for per in pers)
        for words, each in known.items()
    }
    best = min(off, key=lambda words: sum(off[words]))
    told = bool(pers) and off[best][0] < _COUNTS and off[best][-1] < _DENIED
    return (best, known[best]) if told else ("", 0.0)


def by_motion(per: float, units: Sequence[str], scale: float = 1.0) -> Scaling | None:
    """Scaling of channels by what each of their units is [SI]; None where no unit is near.

    ``scale`` makes a unit more of the first one, such as counts of a position in a second.

    Examples
    --------
    >>> by_motion(0.0173, RATES).unit, by_motion(0.3, ("m/s",))
    ('deg/s', None)
    """
    ways = [*map(Scaling, units), Scaling(units[0], scale)]
    off = {i: abs(math.log(max(per, 1e-12) / way.factor)) for i, way in enumerate(ways)}
    best = min(off, key=lambda i: off[i])
    told = replace(ways[best], reason=f"{ways[best].unit} by the motion")
    return told if off[best] < math.log(_NEAR) else None
