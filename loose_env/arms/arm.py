"""The arm under test: a MuJoCo spec, its joints in order, its tool and its figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from loose_env.arms.gear_parameters import Gears
from loose_env.arms.reach import largest_reach
from loose_env.arms.shaker import COIL, Shaker
from loose_env.errors import InvalidSetting, UnknownName

__all__ = ["Arm", "HoldKind", "Holding"]

HoldKind = Literal["brake", "servo", "compliant"]
"""How joints are held: by stiff brakes, by position servos, or by brakes behind elastic gears."""


@dataclass(frozen=True, kw_only=True)
class Holding:
    """How one kind of holding keeps each joint where it is: a spring and a damper per joint."""

    stiffness: tuple[float, ...]
    """Spring of each joint, base first [N·m/rad, or N/m where it slides]."""
    damping: tuple[float, ...]
    """Damper of each joint, base first [N·m·s/rad, or N·s/m where it slides]."""

    def __post_init__(self) -> None:
        if len(self.stiffness) != len(self.damping):
            raise InvalidSetting(
                f"a holding needs as many dampings as stiffnesses, got {len(self.damping)} "
                f"and {len(self.stiffness)}"
            )
        if min(self.stiffness, default=0.0) < 0 or min(self.damping, default=0.0) < 0:
            raise InvalidSetting(
                f"holding stiffness and damping must not be negative, got {self.stiffness} "
                f"and {self.damping}"
            )


@dataclass(frozen=True, kw_only=True, eq=False)
class Arm:
    """A serial arm and every figure a diagnosis of it needs.

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
    """How joints that are not excited are held."""
    gears: Gears | None = None
    """Figures of the gears, for the time they are taken as elastic."""
    gear_joints: tuple[str, ...] = ()
    """Joints of the spec that are elastic gears, base first; none where gears are stiff."""
    rigid: Arm | None = None
    """The same arm with stiff gears; None where this is it."""
    probes: tuple[str, ...] = ()
    """Sites of the spec that carry further accelerometers, read along their own axes."""
    shaker: Shaker | None = None
    """A shaker beside the arm, if there is one."""

    def __post_init__(self) -> None:
        n = len(self.joints)
        if n < 1:
            raise InvalidSetting(f"arm {self.name!r} needs at least one joint")
        for field in ("seat_bodies", "torque_limits", "joint_ranges"):
            if len(getattr(self, field)) != n:
                raise InvalidSetting(
                    f"arm {self.name!r}: {field} has {len(getattr(self, field))} entries, "
                    f"one for each of {n} joints is needed"
                )
        for field in ("brake", "servo", "centring"):
            if len(getattr(self, field).stiffness) != n:
                raise InvalidSetting(
                    f"arm {self.name!r}: {field} has {len(getattr(self, field).stiffness)} "
                    f"entries, one for each of {n} joints is needed"
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
        if any(b <= a for a, b in zip(self.levels, self.levels[1:], strict=False)):
            raise InvalidSetting(f"levels must increase, got {self.levels}")

    @property
    def probe_sites(self) -> tuple[str, ...]:
        """Sites of all further accelerometers: the probes, then the shaker's coil."""
        return self.probes if self.shaker is None else (*self.probes, COIL)

    @property
    def n(self) -> int:
        """Number of joints, and of links."""
        return len(self.joints)

    @property
    def holding(self) -> Holding:
        """What holds the joints that are not excited."""
        return self.servo if self.hold == "servo" else self.brake

    @cached_property
    def model(self) -> mujoco.MjModel:
        """The bare arm, compiled: no seat, motors, brakes or sensors."""
        return self.spec.copy().compile()

    @cached_property
    def pose_addresses(self) -> NDArray[np.intp]:
        """Where each joint lies in the bare arm's ``qpos`` (n,)."""
        return np.array([self.model.joint(name).qposadr[0] for name in self.joints], dtype=np.intp)

    @cached_property
    def sliding(self) -> NDArray[np.bool_]:
        """Whether each joint slides, its figures per metre and in N; else it turns (n,)."""
        slide = mujoco.mjtJoint.mjJNT_SLIDE
        return np.array([self.model.joint(name).type[0] == slide for name in self.joints])

    @cached_property
    def reach(self) -> float:
        """Largest distance from the first joint's anchor to the tool over all poses [m]."""
        return largest_reach(self.model, self.joints, self.joint_ranges, self.tool)

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
        """Whether each joint of a pose lies in its range (n,)."""
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
