"""`Arm`, the arm under test: MuJoCo spec, joints, tool, gears, holding, shaker, link sites."""

from __future__ import annotations

import ctypes
import os
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, get_args

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from loose_env.errors import InvalidSetting, UnknownName
from loose_env.io import Checked, NonNegative, Positive, all_of, is_finite
from loose_env.typing import Array

_lock = threading.Lock()
_before: list[tuple[mujoco.MjLogConfig, int | None]] = []  # one for every call inside `quiet`


@contextmanager
def quiet() -> Iterator[None]:
    """Keep MuJoCo's warnings off the console and out of its log file, and its stopwatch still.

    A diverging simulation is reported through its measurement. Both settings belong to the
    whole process: the first call in saves them, the last one out puts them back.
    """
    with _lock:
        _before.append((mujoco.MjLogConfig.get(), STOPWATCH.value))
        silent = mujoco.MjLogConfig.get()
        silent.logto_console = silent.logto_file = False
        silent.set()
        STOPWATCH.value = None
    try:
        yield
    finally:
        with _lock:
            log, clock = _before.pop()
            if not _before:
                log.set()
                STOPWATCH.value = clock


_LOADED_ALREADY = getattr(os, "RTLD_NOLOAD", 0) | getattr(os, "RTLD_NOW", 0)
"""Mode that opens a library only if the process has loaded it, as the import above does."""


def _found() -> ctypes.c_void_p:
    """Pointer in the engine's library; one that nobody reads where that is out of reach."""
    names = {"win32": "mujoco.dll", "darwin": "libmujoco*.dylib"}
    files = sorted(Path(mujoco.__file__).parent.glob(names.get(sys.platform, "libmujoco.so*")))
    for file in files:
        with suppress(OSError, ValueError):
            library = ctypes.CDLL(str(file), mode=_LOADED_ALREADY)
            return ctypes.c_void_p.in_dll(library, "mjcb_time")
    return ctypes.c_void_p()


STOPWATCH = _found()
"""The engine's pointer to the function that reads the time; set to None, it does not time itself.

It is read at the beginning and the end of every part of every step, for `MjData.timer`: on small
models up to a third of the time of a simulation. No motion depends on it."""


Range = tuple[float, float] | None


def limits_of(ranges: Sequence[Range], *, endless: float = np.pi) -> tuple[Array, Array]:
    """Ends of the ranges of joints [rad or m] (n,) each; of those that turn without end a turn."""
    low, high = np.array([(-endless, endless) if r is None else r for r in ranges], dtype=float).T
    return low, high


_STARTS = 12
"""Random poses from which the search starts, beside the model's own."""
_SWEEPS = 60
_POSES = 24
"""Random poses at which levers are looked at."""
_ENOUGH = 1e-9
"""Relative gain below which a sweep over the joints ends, and a pose counts as no farther."""


def largest_reach(
    model: mujoco.MjModel, joints: Sequence[str], ranges: Sequence[Range], tool: str
) -> float:
    """Find the largest distance from the first joint's anchor to the tool over all poses [m].

    One joint is moved at a time. With the others still, the squared distance is a cosine of a
    hinge's angle and a convex parabola in a slide's position, so each joint goes straight to
    its best place within its range, and no step makes the distance smaller. Several starts, the
    same ones in every call, guard against a bent arm in which no single joint gains.
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    anchor = data.joint(joints[0]).xanchor.copy()
    ids = [int(model.joint(name).id) for name in joints]
    at = np.array([int(model.jnt_qposadr[j]) for j in ids])
    own = model.qpos0[at].copy()
    site = int(model.site(tool).id)
    own_distance = float(np.linalg.norm(data.site_xpos[site] - anchor))

    low, high = limits_of(ranges)
    best = own_distance if bool(np.all((own >= low) & (own <= high))) else 0.0
    rng = np.random.default_rng(0)  # the same arm always has the same reach
    starts = [np.clip(own, low, high), *(low + (high - low) * rng.random((_STARTS, len(ids))))]
    for start in starts:
        data.qpos[at] = start
        reached = 0.0
        for _ in range(_SWEEPS):
            for k, j in enumerate(ids):
                mujoco.mj_kinematics(model, data)
                data.qpos[at[k]] = _best_place(
                    slides=bool(model.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE),
                    axis=data.xaxis[j],
                    tool=data.site_xpos[site] - data.xanchor[j],
                    base=anchor - data.xanchor[j],
                    now=float(data.qpos[at[k]]),
                    limits=ranges[k],
                )
            mujoco.mj_kinematics(model, data)
            before, reached = reached, float(np.linalg.norm(data.site_xpos[site] - anchor))
            if reached <= before * (1 + _ENOUGH):
                break
        if reached > best * (1 + _ENOUGH):
            best = reached
    return best


def _best_place(
    *, slides: bool, axis: Array, tool: Array, base: Array, now: float, limits: Range
) -> float:
    """Position of one joint at which the tool is farthest from the base."""
    if slides:
        if limits is None:
            return now
        along = float((tool - base) @ axis)
        return max(limits, key=lambda place: abs(along + place - now))
    across = tool - (tool @ axis) * axis
    # Turned by t, the distance falls with base . tool = constant + c cos t + s sin t.
    c, s = float(base @ across), float(base @ _cross(axis, across))
    if np.hypot(c, s) < 1e-12:
        return now
    place = now + float(np.arctan2(-s, -c))
    if limits is None:
        return place
    low, high = limits
    place += (
        2 * np.pi * float(np.ceil((low - place) / (2 * np.pi)))
    )  # the first such angle above low
    if place <= high:
        return place
    farthest: float = max(limits, key=lambda end: -c * np.cos(end - now) - s * np.sin(end - now))
    return farthest


def _cross(a: Array, b: Array) -> Array:
    """Cross product of two vectors (3,), without what `numpy.cross` asks of many."""
    (x, y, z), (u, v, w) = a, b
    return np.array([y * w - z * v, z * u - x * w, x * v - y * u])


def largest_levers(
    model: mujoco.MjModel, joints: Sequence[str], ranges: Sequence[Range], tool: str
) -> Array:
    """Largest distance of the tool from each joint's axis over random poses [m] (n,).

    Infinite where a joint slides: every motion of it moves the tool.
    """
    data = mujoco.MjData(model)
    ids = [int(model.joint(name).id) for name in joints]
    slides = np.array([model.jnt_type[i] == mujoco.mjtJoint.mjJNT_SLIDE for i in ids])
    low, high = limits_of(ranges)
    rng = np.random.default_rng(0)  # the same arm always has the same levers
    found = np.zeros(len(ids))
    for _ in range(_POSES):
        data.qpos[[model.jnt_qposadr[i] for i in ids]] = low + (high - low) * rng.random(len(ids))
        mujoco.mj_kinematics(model, data)
        away = data.site(tool).xpos - data.xanchor[ids]
        found = np.maximum(found, np.linalg.norm(np.cross(data.xaxis[ids], away), axis=1))
    return np.where(slides, np.inf, found)


COIL = "shaker_coil"
"""Body of the coil; a site of the same name carries its accelerometer."""
DRIVE = "drive_shaker"
"""Actuator that forces the coil."""
_STAND = "shaker_stand"


@dataclass(frozen=True, kw_only=True)
class Shaker(Checked):
    """An external source of excitation, as in Experiments Two to Six.

    The coil slides along a line fixed to its stand and pushes one point of the arm through
    a stinger, a rod that is stiff along itself and turns freely at its end. Wherever the arm
    is taken, the stand is set up again so that the stinger meets its point along `direction`.
    """

    joint: int
    """Joint the shaker moves, from 1 at the base; it is released while the shaker runs."""
    body: str
    """Body of the arm that the stinger pushes."""
    point: tuple[float, float, float]
    """Point of attack in that body's frame [m]."""
    direction: tuple[float, float, float]
    """Direction of its push, in that body's frame."""
    coil_mass: Positive
    """Mass of the coil and the table on it [kg]."""
    stinger_stiffness: Positive
    """Stiffness of the stinger along itself [N/m] (6.12)."""
    stinger_damping: NonNegative
    """Damping of the stinger [N·s/m]."""
    stinger_length: Positive
    """Length of the stinger [m]."""
    suspension_stiffness: NonNegative
    """Spring that centres the coil [N/m]; it takes the lowest frequencies away."""
    suspension_damping: NonNegative
    """Damping of the coil's suspension and back EMF [N·s/m]."""
    stand: str = "world"
    """Body the stand is fixed to; it takes the reaction."""
    force_limit: Positive = 500.0
    """Largest force of the coil [N]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not np.linalg.norm(self.direction) > 0:
            raise InvalidSetting("a shaker's direction must not be zero")


def add_shaker(spec: mujoco.MjSpec, shaker: Shaker) -> None:
    """Add stand, coil, stinger and drive to a spec; `place_shaker` puts them in their place.

    Raises
    ------
    InvalidSetting
        If the spec lacks a body that the shaker names.
    """
    pushed = spec.body(shaker.body)
    stand_on = spec.worldbody if shaker.stand == "world" else spec.body(shaker.stand)
    for name, body in ((shaker.body, pushed), (shaker.stand, stand_on)):
        if body is None:
            known = ", ".join(b.name for b in spec.bodies)
            raise InvalidSetting(f"the shaker needs a body {name!r}; the arm has {known}")
    stand = stand_on.add_body(name=_STAND)
    coil = stand.add_body(
        name=COIL,
        mass=shaker.coil_mass,
        ipos=[0, 0, 0],
        inertia=[1e-3, 1e-3, 1e-3],  # it does not turn
        explicitinertial=True,
    )
    coil.add_joint(
        name="shaker",
        type=mujoco.mjtJoint.mjJNT_SLIDE,
        axis=[1, 0, 0],
        stiffness=[shaker.suspension_stiffness, 0, 0],
        damping=[shaker.suspension_damping, 0, 0],
    )
    coil.add_site(name=COIL)
    pushed.add_site(name="stinger_end", pos=list(shaker.point))
    stinger = spec.add_tendon(
        name="stinger",
        stiffness=[shaker.stinger_stiffness, 0, 0],
        damping=[shaker.stinger_damping, 0, 0],
        springlength=[shaker.stinger_length, shaker.stinger_length],
    )
    stinger.wrap_site(COIL)
    stinger.wrap_site("stinger_end")
    spec.add_actuator(name=DRIVE, trntype=mujoco.mjtTrn.mjTRN_JOINT, target="shaker")


def place_shaker(model: mujoco.MjModel, data: mujoco.MjData, shaker: Shaker) -> None:
    """Set the stand up for the positions in ``data.qpos``, the stinger at its own length.

    Parameters
    ----------
    model : MjModel
        Changed: the stand's place in its parent.
    data : MjData
        Positions of the arm; scratch space otherwise.
    shaker : Shaker
        The shaker of the model.
    """
    mujoco.mj_kinematics(model, data)
    body = data.body(shaker.body)
    rotation = body.xmat.reshape(3, 3)
    push = rotation @ np.asarray(shaker.direction, dtype=float)
    push /= np.linalg.norm(push)
    origin = body.xpos + rotation @ np.asarray(shaker.point) - shaker.stinger_length * push
    stand = model.body(_STAND)
    parent = data.body(int(stand.parentid[0]))
    turn = parent.xmat.reshape(3, 3).T
    model.body_pos[stand.id] = turn @ (origin - parent.xpos)
    model.body_quat[stand.id] = _turn_x_to(turn @ push)


def _turn_x_to(direction: NDArray[np.float64]) -> NDArray[np.float64]:
    """Quaternion that turns the x axis to a unit vector."""
    x = np.array([1.0, 0.0, 0.0])
    cross = np.cross(x, direction)
    quaternion = np.array([1.0 + x @ direction, *cross])
    if np.linalg.norm(quaternion) < 1e-9:  # straight back
        return np.array([0.0, 0.0, 0.0, 1.0])
    return np.asarray(quaternion / np.linalg.norm(quaternion))


_KINDS = (
    *("bodies", "joints", "sites", "geoms", "cameras", "lights", "meshes", "materials"),
    *("actuators", "sensors", "equalities", "tendons", "excludes", "pairs"),
)
_SETTINGS = ("option", "compiler", "stat")
_OWN = ("id", "classname", "signature")
"""Attributes that belong to the object, not to what it describes."""


def _packed(spec: mujoco.MjSpec) -> tuple[str, dict[tuple[str, int, str], Any]]:
    """XML of a spec, and its numbers by kind of element, index and attribute: XML rounds them."""
    written = spec.copy()
    written.compile()
    return written.to_xml(), dict(_spec_numbers(spec))


def _unpacked(xml: str, numbers: dict[tuple[str, int, str], Any]) -> mujoco.MjSpec:
    spec = mujoco.MjSpec.from_string(xml)
    elements = dict(_elements(spec))
    for (kind, index, name), value in numbers.items():
        element = elements[kind, index]
        now = getattr(element, name)
        if isinstance(now, np.ndarray):
            now[:] = value
        elif now != value:
            setattr(element, name, value)
    return spec


def _elements(spec: mujoco.MjSpec) -> Iterator[tuple[tuple[str, int], Any]]:
    """Elements and settings of a spec, in order."""
    for kind in _KINDS:
        for index, element in enumerate(getattr(spec, kind)):
            yield (kind, index), element
    for kind in _SETTINGS:
        yield (kind, 0), getattr(spec, kind)


def _spec_numbers(spec: mujoco.MjSpec) -> Iterator[tuple[tuple[str, int, str], Any]]:
    """Every number of a spec."""
    for (kind, index), element in _elements(spec):
        for name in dir(element):
            if name.startswith("_") or name in _OWN:
                continue
            value = getattr(element, name)
            if isinstance(value, np.ndarray) and value.dtype.kind in "fiu":
                yield (kind, index, name), np.array(value)
            elif isinstance(value, (int, float)):
                yield (kind, index, name), value


PerJoint = float | Sequence[float]


GEAR_MODE_HZ = 60.0
"""Mode of each gear with all that it carries, where no stiffness is known [Hz]: the upper part
of the 10 to 80 Hz at which industrial arms sway on their drives, as small arms do."""


GEAR_DAMPING = 0.05
"""Damping ratio of that mode [1]; an estimate between steel (0.01) and a lubricated gear (0.1)."""


@dataclass(frozen=True, kw_only=True)
class Gears:
    """Elastic gears of an arm: stiffness, or the mode that it gives, and damping.

    Drives of industrial arms have 1e4 to 1e6 N·m/rad, those of small wrists less.
    """

    stiffness: PerJoint | None = None
    """Stiffness of each joint's gear, at the joint [N·m/rad, or N/m where it slides]."""
    mode_hz: PerJoint = GEAR_MODE_HZ
    """Mode of each gear, motor braked, all other gears stiff, the arm where it is heaviest for the
    joint [Hz]. Not looked at where a stiffness is given."""
    damping_ratio: PerJoint = GEAR_DAMPING
    """Damping ratio of that mode [1]."""

    def __post_init__(self) -> None:
        for name in ("stiffness", "mode_hz", "damping_ratio"):
            if (value := getattr(self, name)) is not None:
                each_joint(f"{name} of the gears", value, max(np.size(value), 1))

    def stiffness_and_damping(self, carried: Array) -> tuple[Array, Array]:
        """Stiffness and damping of each gear that carries an inertia [kg·m², or kg] (n,).

        Raises
        ------
        InvalidSetting
            If there are not as many values as joints.
        """
        n = len(carried)
        ratio = each_joint("damping_ratio", self.damping_ratio, n)
        if self.stiffness is None:
            stiffness = carried * (2 * np.pi * each_joint("mode_hz", self.mode_hz, n)) ** 2
        else:
            stiffness = each_joint("stiffness", self.stiffness, n)
        return stiffness, 2 * ratio * np.sqrt(stiffness * carried)


def each_joint(name: str, value: PerJoint, n: int) -> Array:
    """Check values of the joints, one for all or one for each, and return (n,) of them."""
    try:
        values = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        values = np.array(np.nan)
    wrong = values < 0 if name.startswith("damping_ratio") else values <= 0
    if values.shape not in ((), (n,)) or not np.isfinite(values).all() or wrong.any():
        raise InvalidSetting(
            f"{name} is one positive number, or one for each of {n} joints; got {value!r}"
        )
    return np.broadcast_to(values, n).astype(float)


UNFELT = 0.01
"""Distance of the tool from a joint's axis, over the reach, below which it does not feel the joint
turn [1]: 8 mm for 0.8 m, from where play of 0.4 mm at full reach is 4 µm."""


HoldKind = Literal["brake", "servo", "compliant"]
"""Holding of the joints: stiff brakes, position servos, or brakes behind elastic gears."""


def checked_hold(hold: HoldKind) -> HoldKind:
    """Return a hold that there is."""
    if hold not in get_args(HoldKind):
        raise UnknownName(f"unknown hold {hold!r}; known are {list(get_args(HoldKind))}")
    return hold


@dataclass(frozen=True, kw_only=True)
class Holding(Checked):
    """Brakes or servos as a spring and a damper for each joint."""

    stiffness: tuple[NonNegative, ...]
    """Spring of each joint, base first [N·m/rad, or N/m where it slides]."""
    damping: tuple[NonNegative, ...]
    """Damper of each joint, base first [N·m·s/rad, or N·s/m where it slides]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.stiffness) != len(self.damping):
            raise InvalidSetting(
                f"a holding needs as many dampings as stiffnesses, got {len(self.damping)} "
                f"and {len(self.stiffness)}"
            )


@dataclass(frozen=True, kw_only=True, eq=False)
class Arm:
    """A serial arm and every parameter a diagnosis of it needs.

    Links are numbered from the base, starting at 1; link ``i`` moves with joint ``i``.
    The spec holds bodies, joints and the tool site only: motors, brakes, sensors and the
    loose seat are added when the arm is put on a rig.
    """

    name: str
    """Short name, used in messages and tables."""
    spec: mujoco.MjSpec
    """The arm itself. Treated as read-only: copy it before editing."""
    joints: tuple[str, ...]
    """Names of the driven joints, base first."""
    seat_bodies: tuple[str, ...]
    """For each link, the body at whose proximal end its seat lies."""
    tool: str
    """Site that carries the tool accelerometer; its axes are the tool frame."""
    axes: tuple[int, ...]
    """Axes of the tool frame that the accelerometer measures (0, 1 in the plane)."""
    torque_limits: tuple[float, ...]
    """Peak drive torque of each joint [N·m, or N where it slides]."""
    joint_ranges: tuple[tuple[float, float] | None, ...]
    """Allowed positions of each joint [rad or m]; None for a joint that turns without end."""
    levels: tuple[float, ...]
    """Excitation levels 1, 2, ...: rms acceleration at the nominal tool [m/s²]."""
    band: tuple[float, float]
    """Band of the excitation [Hz]."""
    brake: Holding
    """Brakes of the joints that are not excited."""
    servo: Holding
    """Position servos, the softer way of holding: their proportional and derivative gains."""
    centring: Holding
    """Soft spring that keeps an excited joint near its pose; its modes lie below the band."""
    timestep: float
    """Simulation step [s], from the step-halving study."""
    settling: float = 0.1
    """Excitation before a record, in which seat, holdings and bending modes settle [s]."""
    hold: HoldKind = "brake"
    """Holding of the joints that are not excited."""
    gears: Gears | None = None
    """Parameters of the gears, used where they are elastic."""
    gear_joints: tuple[str, ...] = ()
    """Joints of the spec that are elastic gears, base first; none where gears are stiff."""
    rigid: Arm | None = None
    """The same arm with stiff gears; None where this is it."""
    probes: tuple[str, ...] = ()
    """Sites of the spec that carry further accelerometers, read along their own axes."""
    shaker: Shaker | None = None
    """A shaker beside the arm, if there is one."""
    rated_level: float | None = None
    """Level to which the friction of seats is compared [m/s²]; None: the highest of `levels`.

    An arm of weaker levels keeps it, so that the same seats are harder to open."""

    def __post_init__(self) -> None:
        n = len(self.joints)
        if n < 1:
            raise InvalidSetting(f"arm {self.name!r} needs at least one joint")
        own = ("seat_bodies", "torque_limits", "joint_ranges")
        counts = {field: len(getattr(self, field)) for field in own}
        held = ("brake", "servo", "centring")
        counts |= {field: len(getattr(self, field).stiffness) for field in held}
        for field, count in counts.items():
            if count != n:
                raise InvalidSetting(
                    f"arm {self.name!r}: {field} has {count} entries, one for each of {n} joints "
                    "is needed"
                )
        if checked_hold(self.hold) == "compliant" and len(self.gear_joints) != n:
            raise InvalidSetting(
                f"arm {self.name!r} has no elastic gears to hold by: make it with "
                "with_compliance(arm)"
            )
        if not 0 < self.band[0] < self.band[1]:
            raise InvalidSetting(f"band must be 0 < low < high in Hz, got {self.band}")
        if not self.levels or any(
            b <= a for a, b in zip((0.0, *self.levels), self.levels, strict=False)
        ):
            raise InvalidSetting(f"levels are positive and increase, got {self.levels}")

    def __copy__(self) -> Arm:
        """Return the arm itself: it is read-only."""
        return self

    def __deepcopy__(self, memo: object) -> Arm:
        """Return the arm itself: it is read-only."""
        return self

    def __getstate__(self) -> dict[str, Any]:
        """Fields as plain data, for pickle."""
        found = {each.name: getattr(self, each.name) for each in fields(self)}
        return {**found, "spec": _packed(self.spec)}

    def __setstate__(self, stored: dict[str, Any]) -> None:
        """Take up fields from pickle."""
        for name, value in {**stored, "spec": _unpacked(*stored["spec"])}.items():
            object.__setattr__(self, name, value)

    @property
    def probe_sites(self) -> tuple[str, ...]:
        """Sites of all further accelerometers: the probes, then the shaker's coil."""
        return self.probes if self.shaker is None else (*self.probes, COIL)

    def with_levels(self, levels: Sequence[float]) -> Arm:
        """Return the same arm with other excitation levels; its seats keep their friction.

        Parameters
        ----------
        levels : sequence of float
            Rms accelerations at the nominal tool, increasing [m/s²].

        Raises
        ------
        InvalidSetting
            If they are no positive numbers that increase.

        Examples
        --------
        >>> from loose_env.arms import six_axis
        >>> weak = six_axis().with_levels((1.0, 2.0))
        >>> weak.levels, weak.top_level
        ((1.0, 2.0), 4.0)
        """
        if not all_of(levels, is_finite, least=1):
            raise InvalidSetting(
                f"levels are one or more finite numbers [m/s²] that increase, got {levels!r}"
            )
        rigid = None if self.rigid is None else self.rigid.with_levels(levels)
        own = tuple(float(level) for level in levels)
        return replace(self, levels=own, rated_level=self.top_level, rigid=rigid)

    def under_gravity(self, gravity: Sequence[float]) -> Arm:
        """Return the same arm under another gravity, as where it hangs or stands on a slope.

        Parameters
        ----------
        gravity : sequence of 3 float
            In the world's axes [m/s²].

        Raises
        ------
        InvalidSetting
            If they are not three finite numbers.

        Examples
        --------
        >>> from loose_env.arms import vera
        >>> vera().under_gravity((0, -9.81, 0)).model.opt.gravity.tolist()
        [0.0, -9.81, 0.0]
        """
        if not all_of(gravity, is_finite, least=3) or len(gravity) != 3:
            raise InvalidSetting(
                f"gravity is three finite numbers, along x, y and z [m/s²], got {gravity!r}"
            )
        spec = self.spec.copy()
        spec.option.gravity = [float(g) for g in gravity]
        rigid = None if self.rigid is None else self.rigid.under_gravity(gravity)
        return replace(self, spec=spec, rigid=rigid)

    @property
    def top_level(self) -> float:
        """Level to which the friction of seats is compared [m/s²]."""
        return self.levels[-1] if self.rated_level is None else self.rated_level

    @property
    def n(self) -> int:
        """Number of joints, and of links."""
        return len(self.joints)

    @property
    def holding(self) -> Holding:
        """Holding of the joints that are not excited."""
        return self.servo if self.hold == "servo" else self.brake

    @cached_property
    def model(self) -> mujoco.MjModel:
        """The bare arm, compiled: no seat, motors, brakes or sensors."""
        return self.spec.copy().compile()

    @cached_property
    def pose_addresses(self) -> NDArray[np.intp]:
        """Index of each joint in the bare arm's ``qpos`` (n,)."""
        return np.array([self.model.joint(name).qposadr[0] for name in self.joints], dtype=np.intp)

    @cached_property
    def sliding(self) -> NDArray[np.bool_]:
        """True for each joint that slides, with parameters per metre and in N (n,)."""
        slide = mujoco.mjtJoint.mjJNT_SLIDE
        return np.array([self.model.joint(name).type[0] == slide for name in self.joints])

    @cached_property
    def reach(self) -> float:
        """Largest distance from the first joint's anchor to the tool over all poses [m]."""
        return largest_reach(self.model, self.joints, self.joint_ranges, self.tool)

    @cached_property
    def unfelt_joints(self) -> tuple[int, ...]:
        """Joints whose motion does not move the tool in any pose: it lies on their axis.

        Numbers from 1. Play in such a joint leaves no trace in the tool's motion, so that it is no
        hypothesis of an environment; see `loose_env.faults.hypotheses`.
        """
        levers = largest_levers(self.model, self.joints, self.joint_ranges, self.tool)
        return tuple(int(j) + 1 for j in np.flatnonzero(levers < UNFELT * self.reach))

    def link_number(self, link: int) -> int:
        """Check a link or joint number and return it.

        Raises
        ------
        UnknownName
            If there is no such link.
        """
        if isinstance(link, bool) or not isinstance(link, (int, np.integer)):
            raise UnknownName(f"a link is given by its number, 1 to {self.n}; got {link!r}")
        if not 1 <= link <= self.n:
            raise UnknownName(
                f"arm {self.name!r} has links 1 to {self.n}, each on its joint, from the base; "
                f"got {link}"
            )
        return int(link)

    def checked_pose(self, pose: ArrayLike, *, reachable: bool = False) -> Array:
        """Check a pose [rad or m] and return it (n,).

        Raises
        ------
        InvalidSetting
            If it does not have one finite number for every joint, or, to be ``reachable``, one
            outside the joint's range.
        """
        try:
            found = np.asarray(pose, dtype=float)
        except (TypeError, ValueError):
            found = np.empty(0)
        if found.shape != (self.n,) or not np.isfinite(found).all():
            raise InvalidSetting(
                f"a pose of {self.name!r} is {self.n} finite numbers [rad or m], got {pose!r}"
            )
        if reachable and not self.within_ranges(found).all():
            ranges = [r and (float(r[0]), float(r[1])) for r in self.joint_ranges]
            raise InvalidSetting(
                f"pose {found.tolist()} leaves the joint ranges {ranges} [rad or m]"
            )
        return found

    def within_ranges(self, pose: Sequence[float] | NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return, for each joint of a pose, whether it lies in its range (n,)."""
        low, high = limits_of(self.joint_ranges, endless=np.inf)
        at = np.asarray(pose, dtype=float)
        return np.asarray((low - 1e-9 <= at) & (at <= high + 1e-9))

    def wrap(self, pose: NDArray[np.float64]) -> NDArray[np.float64]:
        """Bring joints of poses (..., n) that turn without end into [-pi, pi)."""
        wrapped = np.array(pose, dtype=float)
        for j, r in enumerate(self.joint_ranges):
            if r is None:
                wrapped[..., j] = (wrapped[..., j] + np.pi) % (2 * np.pi) - np.pi
        return wrapped

    def random_pose(self, rng: np.random.Generator) -> NDArray[np.float64]:
        """Draw a pose, uniform over the joints' ranges [rad] (n,)."""
        return np.asarray(self.random_poses([rng])[0])

    def random_poses(self, rngs: Sequence[np.random.Generator]) -> NDArray[np.float64]:
        """Draw a pose from each of B generators (B, n); as `random_pose`."""
        low, high = limits_of(self.joint_ranges)
        return np.asarray(low + (high - low) * np.array([rng.random(self.n) for rng in rngs]))


Place = Literal["proximal", "distal"]

CLEARANCE = 0.05
"""Least distance of a distal sensor from the axis of the link's own joint [m].

In a wrist whose axes cross, the next joint's centre lies on the own joint's axis, where that
joint's motion shows nothing. A sensor sits on the outside of the link, off the axis."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LinkSite:
    """A place on a link, in the frame of the body that carries it."""

    link: int
    """Number of the link."""
    body: str
    """The body: of a link that bends, the part at that end."""
    position: Array
    """Position in the body's frame [m] (3,)."""
    tangent: Array
    """Direction in which the link's own joint moves the place, unit vector, body frame (3,)."""
    scaled_by: int
    """Body of the bare arm whose distance from its parent the place shares; -1 for none."""

    @property
    def tangential_frame(self) -> Array:
        """Rotation whose x axis is the tangent; columns are its axes in the body's frame (3, 3)."""
        x = self.tangent
        z = np.eye(3)[int(np.argmin(np.abs(x)))]
        z = z - (z @ x) * x
        z /= np.linalg.norm(z)
        return np.column_stack([x, np.cross(z, x), z])

    @property
    def tangential_quat(self) -> list[float]:
        """`tangential_frame` as a quaternion (4,)."""
        return quat_of(self.tangential_frame)


def quat_of(rotation: Array) -> list[float]:
    """Quaternion (4,) of a rotation (3, 3)."""
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, np.ascontiguousarray(rotation).ravel())
    return [float(q) for q in quat]


def link_site(arm: Arm, link: int, place: Place = "distal") -> LinkSite:
    """Find a place on a link.

    Parameters
    ----------
    arm : Arm
        The arm.
    link : int
        Number of the link, from 1 at the base.
    place : {"distal", "proximal"}
        "distal": where the next joint sits, or the tool on the last link, but `CLEARANCE` off
        the axis of a turning joint at least. "proximal": the origin of the link's seat, where
        its own turning joint has no lever; the tangent is zero there.

    Raises
    ------
    UnknownName
        If there is no such link or place.

    Examples
    --------
    >>> from loose_env.arms import planar
    >>> site = link_site(planar(3), 1)
    >>> site.body, site.position.tolist(), site.tangent.tolist()
    ('link1', [0.3, 0.0, 0.0], [0.0, 1.0, 0.0])
    """
    i = arm.link_number(link) - 1
    if place not in ("proximal", "distal"):
        raise UnknownName(f"a sensor sits at the 'proximal' or 'distal' end, got {place!r}")
    m = arm.model
    if place == "proximal":
        return LinkSite(
            link=link,
            body=arm.seat_bodies[i],
            position=np.zeros(3),
            tangent=np.zeros(3),
            scaled_by=-1,
        )
    if i + 1 < arm.n:
        joint = m.joint(arm.joints[i + 1])
        beyond = scaled_by = int(joint.bodyid[0])
        body = int(m.body_parentid[beyond])
        anchor = np.zeros(3)
        mujoco.mju_rotVecQuat(anchor, joint.pos, m.body_quat[beyond])
        position = m.body_pos[beyond] + anchor
    else:
        site = m.site(arm.tool)
        body = scaled_by = int(site.bodyid[0])
        position = np.array(site.pos)
    # The rest of the arm does not matter: the own joint moves all of the link alike.
    data = mujoco.MjData(m)
    mujoco.mj_kinematics(m, data)
    turn = data.xmat[body].reshape(3, 3)
    own = m.joint(arm.joints[i])
    axis = turn.T @ data.xaxis[own.id]
    if own.type[0] == mujoco.mjtJoint.mjJNT_SLIDE:
        tangent = axis
    else:
        lever = position - turn.T @ (data.xanchor[own.id] - data.xpos[body])
        lever = lever - (lever @ axis) * axis
        length = float(np.linalg.norm(lever))
        if length < CLEARANCE:
            if length > 1e-6:
                away = lever / length
            else:
                away = np.eye(3)[int(np.argmin(np.abs(axis).round(9)))]
                away = away - (away @ axis) * axis
                away /= np.linalg.norm(away)
            position = position + (CLEARANCE - length) * away
            lever = CLEARANCE * away
        tangent = np.cross(axis, lever)
        tangent /= np.linalg.norm(tangent)
    return LinkSite(
        link=link,
        body=m.body(body).name,
        position=position,
        tangent=tangent.round(12) + 0.0,
        scaled_by=scaled_by,
    )
