"""The arm under test: a MuJoCo spec, its joints in order, its tool, its gears."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.arms.packed_spec import PackedSpec
from loose_env.arms.reach import largest_levers, largest_reach
from loose_env.arms.shaker import COIL, Shaker
from loose_env.errors import InvalidSetting, UnknownName
from loose_env.io import Checked, NonNegative, all_of, is_finite
from loose_env.typing import Array

__all__ = [
    "GEAR_DAMPING",
    "GEAR_MODE_HZ",
    "Arm",
    "Gears",
    "HoldKind",
    "Holding",
    "PerJoint",
    "each_joint",
]


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

    stiffness: tuple[float, ...] | None = None
    """Stiffness of each joint's gear, at the joint [N·m/rad, or N/m where it slides]."""
    mode_hz: float | tuple[float, ...] = GEAR_MODE_HZ
    """Mode of each gear, motor braked, all other gears stiff, the arm where it is heaviest for the
    joint [Hz]. Not looked at where a stiffness is given."""
    damping_ratio: float | tuple[float, ...] = GEAR_DAMPING
    """Damping ratio of that mode [1]."""

    def __post_init__(self) -> None:
        for name in ("stiffness", "mode_hz", "damping_ratio"):
            value = getattr(self, name)
            if value is None:
                continue
            values = np.atleast_1d(_numbers(value))
            low = values < 0 if name == "damping_ratio" else values <= 0
            if values.ndim != 1 or not np.isfinite(values).all() or low.any():
                raise InvalidSetting(
                    f"{name} of the gears must be finite and positive, one number or one for each "
                    f"joint; got {value!r}"
                )

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
    values = _numbers(value)
    wrong = values < 0 if name == "damping_ratio" else values <= 0
    if values.shape not in ((), (n,)) or not np.isfinite(values).all() or wrong.any():
        raise InvalidSetting(
            f"{name} is one positive number, or one for each of {n} joints; got {value!r}"
        )
    return np.broadcast_to(values, n).astype(float)


def _numbers(value: object) -> Array:
    """Convert to floats; NaN, which no check passes, where it is no number."""
    try:
        return np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        return np.array(np.nan)


UNFELT = 0.01
"""Distance of the tool from a joint's axis, over the reach, below which it does not feel the joint
turn [1]: 8 mm for 0.8 m, from where play of 0.4 mm at full reach is 4 µm."""


HoldKind = Literal["brake", "servo", "compliant"]
"""Holding of the joints: stiff brakes, position servos, or brakes behind elastic gears."""


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
        if self.hold not in ("brake", "servo", "compliant"):
            raise UnknownName(f"unknown hold {self.hold!r}: 'brake', 'servo' or 'compliant'")
        if len(self.gear_joints) != (n if self.hold == "compliant" else len(self.gear_joints)):
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
        return {**found, "spec": PackedSpec.of(self.spec)}

    def __setstate__(self, stored: dict[str, Any]) -> None:
        """Take up fields from pickle."""
        for name, value in {**stored, "spec": stored["spec"].unpack()}.items():
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
                f"arm {self.name!r} has links 1 to {self.n}, counted from the base; got {link}"
            )
        return int(link)

    def within_ranges(self, pose: Sequence[float] | NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return, for each joint of a pose, whether it lies in its range (n,)."""
        return np.array(
            [
                r is None or r[0] - 1e-9 <= q <= r[1] + 1e-9
                for q, r in zip(pose, self.joint_ranges, strict=True)
            ]
        )

    def wrap(self, pose: NDArray[np.float64]) -> NDArray[np.float64]:
        """Bring joints that turn without end into [-pi, pi)."""
        wrapped = np.array(pose, dtype=float)
        for j, r in enumerate(self.joint_ranges):
            if r is None:
                wrapped[j] = (wrapped[j] + np.pi) % (2 * np.pi) - np.pi
        return wrapped

    def random_pose(self, rng: np.random.Generator) -> NDArray[np.float64]:
        """Draw a pose, uniform over the joints' ranges [rad] (n,)."""
        low = np.array([-np.pi if r is None else r[0] for r in self.joint_ranges])
        high = np.array([np.pi if r is None else r[1] for r in self.joint_ranges])
        return np.asarray(low + (high - low) * rng.random(self.n))
