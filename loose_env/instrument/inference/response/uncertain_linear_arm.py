"""Arm linearised about a pose, with first-order nuisance parameters.

With x the small motion of joints and elastic parts, and s that of a seat, the arm obeys

    Z x = F - M_xs a_s,    Z = -w^2 M_xx + i w D + K,

M its inertia, K what servos, springs and gravity add, D what dampers add, F the forces of the
drives, a_s the seat's acceleration. Accelerometers read the proper acceleration, so that gravity
turns with the tool. The change of every reading by each error of the model follows from the
motion alone. Elastic parts are those of the model, and gears, links and the base as
`elastic_coordinates` has them, with stiffness among the errors.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import mujoco
import numpy as np

from loose_env.arms import LinearArm, MismatchDraw
from loose_env.instrument.inference.response.elastic_coordinates import elastic_coordinates
from loose_env.instrument.model.instrumented_arm import InstrumentedArm
from loose_env.instrument.settings.thresholds import (
    ELASTIC_LOSS,
    PARAMETER_TAIL,
    RIGID_SD,
    STIFFNESS_SD,
)
from loose_env.instrument.settings.tolerances import Tolerances
from loose_env.typing import Array, ComplexArray

DELAYS = ("command_delay", "sensor_delay")
"""Errors drawn anew for every run: player, encoders and accelerometers start on their own clocks;
named as in `Tolerances`."""
_RIGID = 6.0
"""Stiffness of a rigid arm above that with which fits start [standard deviations]."""
_NORMAL = 1e6
"""Errors beyond which nothing is [standard deviations]."""
_STEP = 1e-4
"""Turn by which gravity's stiffness is found [rad or m]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Bodies:
    """Terms that depend on bodies and pose: m coordinates, s seats (slides, plays, rotations)."""

    inertia: Array
    """(m + s, m + s)."""
    jacobian: Array
    """Acceleration of every site per acceleration, in its frame (S, 3, m + s)."""
    turning: Array
    """Angular the same (S, 3, m + s)."""
    gravity: Array
    """Proper acceleration at rest in every site's frame (S, 3)."""
    load: Array
    """Generalised force against gravity (m + s,)."""


class UncertainArm:
    """Arm with nuisance parameters, scaled by their standard deviations."""

    def __init__(self, arm: InstrumentedArm, tolerances: Tolerances) -> None:
        self.arm, self.tolerances = arm, tolerances
        nominal, n = arm.nominal, arm.n
        self.linear = linear = LinearArm(nominal, rotations=True)
        self.moving = np.concatenate([linear.joint_dofs, linear.flexible_dofs])
        self.seats = _seat_columns(linear)
        self.elastic = elastic_coordinates(linear, self.seats, joints=arm.joints, links=arm.links)
        self.slides = np.arange(3 * n).reshape(n, 3)
        self.plays = np.arange(3 * n, 4 * n)
        self.bendings = np.arange(4 * n, 7 * n).reshape(n, 3)
        none = MismatchDraw.none(nominal)
        names: list[str] = []
        self._changed: list[LinearArm] = []
        t = tolerances
        for field, size in (
            ("length", t.length),
            ("mass", t.inertial_parameters),
            ("inertia", t.inertial_parameters),
        ):
            for link in range(n):
                factor = getattr(none, field).copy()
                factor[_bodies_of(arm, link)] += size
                self._changed.append(_changed(self, replace(none, **{field: factor})))
                names.append(f"{field}@{arm.links[link]}")
        for link in range(n):
            # Mass goes over the seat: what of a link is bolted to the motor's side is a guess.
            own, flange = _bodies_of(arm, link)
            moved = t.motor_side * nominal.model.body_mass[own]
            factor = none.mass.copy()
            factor[own] -= t.motor_side
            factor[flange] += moved / max(nominal.model.body_mass[flange], 1e-12)
            self._changed.append(_changed(self, replace(none, mass=factor)))
            names.append(f"motor_side@{arm.links[link]}")
        self.motor_sides = slice(len(names) - n, len(names))
        self._zeros = t.joint_zero * np.eye(n)
        names += [f"zero@{joint}" for joint in arm.joints]
        names += [f"rotor@{joint}" for joint in arm.joints]
        self.places = sorted({r.at for r in arm.readings if r.kind == "acceleration"})
        names += [f"offset_{axis}@{arm.sites[k]}" for k in self.places for axis in "xyz"]
        self.bodies = slice(0, len(names))
        joints = arm.joints
        names += [f"damping@{joint}" for joint in joints]
        names += [f"servo_stiffness@{joint}" for joint in joints]
        names += [f"servo_damping@{joint}" for joint in joints]
        self.springs = slice(self.bodies.stop, len(names))
        names += [f"drive_gain@{joint}" for joint in joints]
        self.gains = slice(self.springs.stop, len(names))
        names += self.elastic.names
        self.stiffnesses = slice(self.gains.stop, len(names))
        self.sensors = tuple(k for k, r in enumerate(arm.readings) if r.on_site)
        for k in self.sensors:
            names += [f"{arm.readings[k].sensor}[{i}{j}]" for i in "xyz" for j in "xyz"]
        self.sensing = slice(self.stiffnesses.stop, len(names))
        names += ["sensor_clock", "sensor_bandwidth"]
        self.reading_lag = slice(self.sensing.stop, len(names))
        self.names = tuple(names)
        """Name of each error that all runs share (P,)."""
        self._remembered: dict[bytes, PoseModel] = {}

    def count(self, runs: int) -> int:
        """Number of nuisance parameters: those shared, then the delays of each run."""
        return len(self.names) + len(DELAYS) * runs

    def expected(self, runs: int) -> Array:
        """Prior medians of all parameters: zero but for stiffness, whose zero is a rigid arm."""
        found = np.zeros(self.count(runs))
        found[self.stiffnesses][: self.elastic.count] = -RIGID_SD
        return found

    def softer(self, errors: Array, hertz: Sequence[float]) -> list[list[Array]]:
        """Copies of parameters in which gears, base or links have modes at some frequencies.

        One list for each kind of elastic part, with one copy for each frequency [Hz].
        """
        found = []
        for kind in self.elastic.kinds:
            chosen, own = self.elastic.of_kind(kind), self.stiffnesses
            found.append([errors.copy() for _ in hertz])
            for one, each in zip(found[-1], hertz, strict=True):
                there = self.elastic.with_modes(each) / STIFFNESS_SD
                there[: self.elastic.count] -= RIGID_SD
                one[own] = np.where(chosen, there, one[own])
        return found

    @property
    def nominal(self) -> Array:
        """Errors of the arm as its model has it, rigid (P,)."""
        found = np.zeros(len(self.names))
        found[self.stiffnesses][: self.elastic.count] = _RIGID
        return found

    def tails(self, runs: int) -> Array:
        """Errors beyond which the prior falls exponentially only [standard deviations] (P,).

        Shares of a link's mass are bounded by none and all of it: theirs is normal.
        """
        found = np.full(self.count(runs), PARAMETER_TAIL)
        found[self.motor_sides] = _NORMAL
        return found

    def delays(self, run: int) -> slice:
        """Indices of a run's own delay parameters; see `DELAYS`."""
        start = self.count(run)
        return slice(start, start + len(DELAYS))

    def at(self, pose: Array) -> PoseModel:
        """Linearise about a pose (n,) [rad or m]; results are cached."""
        key = np.asarray(pose, dtype=float).tobytes()
        if key not in self._remembered:
            self._remembered[key] = self._at(np.asarray(pose, dtype=float))
        return self._remembered[key]

    def _at(self, pose: Array) -> PoseModel:
        linear, n = self.linear, self.arm.n
        nominal = self._bodies(linear, pose)
        moved = [self._bodies(one, pose) for one in self._changed]
        moved += [self._bodies(linear, pose + zero) for zero in self._zeros]
        size = nominal.inertia.shape
        inertia = [m.inertia - nominal.inertia for m in moved]
        jacobian = [m.jacobian - nominal.jacobian for m in moved]
        for j in range(n):
            rotor = np.zeros(size)
            rotor[j, j] = (
                self.tolerances.inertial_parameters
                * linear.model.dof_armature[linear.joint_dofs[j]]
            )
            inertia.append(rotor)
            jacobian.append(np.zeros_like(nominal.jacobian))
        for k in self.places:
            for axis in np.eye(3):
                moved_site = np.zeros_like(nominal.jacobian)
                away = self.tolerances.sensor_offset * axis
                moved_site[k] = np.cross(nominal.turning[k], away[:, None], axis=0)
                inertia.append(np.zeros(size))
                jacobian.append(moved_site)
        m = size[0] - self.seats.shape[1]
        weight, turned = np.zeros((size[0], m)), np.zeros((*nominal.gravity.shape, m))
        for j in range(n):
            step = _STEP * np.eye(n)[j]
            up, down = self._bodies(linear, pose + step), self._bodies(linear, pose - step)
            weight[:, j] = (up.load - down.load) / (2 * _STEP)
            turned[:, :, j] = (up.gravity - down.gravity) / (2 * _STEP)
        return PoseModel(
            of=self,
            pose=pose,
            nominal=nominal,
            inertia=np.array(inertia),
            jacobian=np.array(jacobian),
            weight=weight,
            turned=turned,
        )

    def _bodies(self, linear: LinearArm, pose: Array) -> _Bodies:
        model, data = linear.model, linear._data
        mujoco.mj_resetData(model, data)
        for name, value in zip(linear.arm.joints, pose, strict=True):
            data.joint(name).qpos[0] = value
        mujoco.mj_forward(model, data)
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, full)
        basis = np.concatenate(
            [np.eye(model.nv)[:, self.moving], self.elastic.columns, self.seats], axis=1
        )
        sites = (linear.arm.tool, *linear.arm.probes)
        jacobian = np.zeros((len(sites), 3, basis.shape[1]))
        turning, gravity = np.zeros_like(jacobian), np.zeros((len(sites), 3))
        for k, name in enumerate(sites):
            site = model.site(name).id
            linear_part, angular = np.zeros((3, model.nv)), np.zeros((3, model.nv))
            mujoco.mj_jacSite(model, data, linear_part, angular, site)
            back = data.site_xmat[site].reshape(3, 3).T
            jacobian[k], turning[k] = back @ linear_part @ basis, back @ angular @ basis
            gravity[k] = -back @ model.opt.gravity
        return _Bodies(
            inertia=basis.T @ full @ basis,
            jacobian=jacobian,
            turning=turning,
            gravity=gravity,
            load=basis.T @ data.qfrc_bias,
        )


def _bodies_of(arm: InstrumentedArm, link: int) -> list[int]:
    """Link and flange bodies in the arm's own model."""
    model = arm.nominal.model
    own = int(model.body(arm.nominal.seat_bodies[link]).id)
    return [own, int(model.body_parentid[own])]


def _changed(uncertain: UncertainArm, draw: MismatchDraw) -> LinearArm:
    """Copy of the linear arm with changed bodies."""
    linear = uncertain.linear
    other = copy.copy(linear)
    other.model = copy.copy(linear.model)
    other._data = mujoco.MjData(other.model)
    other._cache = {}
    draw.apply(other.model, linear.arm, other._data)
    return other


def _seat_columns(linear: LinearArm) -> Array:
    """Seat motions in the linear arm's coordinates (nv, 7 n): slides, play, rotations of links."""
    n, nv = linear.arm.n, linear.model.nv
    columns = np.zeros((nv, 7 * n))
    for link in range(n):
        columns[linear.slide_dofs[link], 3 * link + np.arange(3)] = 1.0
        columns[linear.turn_dofs[link], 4 * n + 3 * link + np.arange(3)] = 1.0
    if linear.play is not None:  # it is made of the links' slides and rotations
        columns[:, 3 * n : 4 * n] = linear.play
    return columns


@dataclass(frozen=True, kw_only=True, eq=False)
class PoseModel:
    """Uncertain arm linearised about one pose.

    Errors come in the order of `UncertainArm.names`, those of the runs' delays after them.
    """

    of: UncertainArm
    pose: Array
    nominal: _Bodies
    inertia: Array
    """Change of the inertia by each error of bodies, zeros, rotors and places of sensors
    (G, m + s, m + s)."""
    jacobian: Array
    """Change of the sites' Jacobians by the same (G, S, 3, m + s)."""
    weight: Array
    """Change of the load by each moving coordinate (m + s, m)."""
    turned: Array
    """Change of gravity's reading by each moving coordinate (S, 3, m)."""

    @cached_property
    def inertia_by_row(self) -> Array:
        """Change of the inertia that acts on moving coordinates, by row (m + s, G, m)."""
        return np.ascontiguousarray(self.inertia[:, : self.size].transpose(2, 0, 1))

    @property
    def rigid(self) -> int:
        """Number of coordinates of the model: joints and its own elastic parts, which come first.

        They alone answer a sudden force: what is beyond a spring follows later.
        """
        return len(self.of.moving)

    @property
    def size(self) -> int:
        """Number of coordinates."""
        return self.rigid + self.of.elastic.count

    def seat_load(self) -> Array:
        """Static force on each seat's columns (7 n,) [N or N·m]."""
        return self.nominal.load[self.size :]

    def parts(self, errors: Array) -> tuple[Array, Array]:
        """Inertia and Jacobians for given nuisance parameters."""
        some = errors[self.of.bodies]
        return (
            self.nominal.inertia + np.tensordot(some, self.inertia, 1),
            self.nominal.jacobian + np.tensordot(some, self.jacobian, 1),
        )

    def springs(self, errors: Array) -> tuple[ComplexArray, Array]:
        """Coordinate stiffness, its loss the imaginary part, (m, m) and damping (m,)."""
        arm, t = self.of.arm, self.of.tolerances
        n, r, drives = arm.n, self.rigid, arm.actuators
        own, held, slow = np.split(errors[self.of.springs], 3)
        stiff, damped = (v[self.of.moving] for v in self.of.linear.springs)
        stiff[:n] += drives.stiffness * (1 + t.servo_gain * held)
        stiffness = np.zeros((self.size, self.size), dtype=complex)
        stiffness[:r, :r] = np.diag(stiff)
        stiffness[r:, r:] = self.elastic_stiffness(errors)
        damping = np.zeros(self.size)
        damping[:r] = damped
        damping[:n] *= 1 + t.damping * own
        damping[:n] += drives.damping * (1 + t.servo_gain * slow)
        return stiffness, damping

    def elastic_stiffness(self, errors: Array) -> ComplexArray:
        """Stiffness of gears, base and links for given nuisance parameters (E, E)."""
        found = self.of.elastic.matrix(self._log_stiffness(errors))
        return np.asarray(found * (1 + 1j * ELASTIC_LOSS))

    def elastic_slopes(self, errors: Array) -> ComplexArray:
        """Change of the same by each of its parameters (Q, E, E)."""
        found = self.of.elastic.slopes(self._log_stiffness(errors))
        return np.asarray(STIFFNESS_SD * found * (1 + 1j * ELASTIC_LOSS))

    def _log_stiffness(self, errors: Array) -> Array:
        found = errors[self.of.stiffnesses].copy()
        found[: self.of.elastic.count] += RIGID_SD
        return np.asarray(STIFFNESS_SD * found)
