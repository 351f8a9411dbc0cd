"""Simulation of a machine as built, and of a session on it: gears, servo, friction, faults, world.

Each joint is a rotor and a link with a spring, hysteresis and a kinematic error between them; the
controller sees the rotor at its own rate. A loose seat is a slide with stops at the base of a
link, play a hinge or slide with stops behind the gear.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, Protocol

import mujoco
import numpy as np

from loose_env.errors import InvalidData
from loose_env.typing import Array
from scripts.suites.instrument.machines import STEP, Design, Sheet, nominal_spec

SETTLE = 0.7
"""Time at the pose before a run is recorded [s]."""
SPRING = 1e3
"""Stiffness of the long spring that preloads a seat [N/m]."""
GRAVITY = np.array([0.0, 0.0, -9.81])
KINDS = ("structural_looseness", "backlash")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Fault:
    """A loose seat at a body, or play in a joint."""

    kind: str
    at: str
    """Body of a seat, joint of play."""
    index: int
    """Number of the link."""
    clearance: float
    """Free travel [m] or [rad]."""
    direction: tuple[float, float, float] | None = None
    """Of a seat, in the body's frame."""
    friction: float = 0.0
    preload: float = 0.0
    """Force that presses a seat shut [N]."""
    stop_hz: float = 600.0
    """Frequency of what touches its stop."""
    stop_ratio: float = 0.25
    """Damping ratio of the same."""

    @property
    def name(self) -> str:
        """Kind and place."""
        return f"{self.kind}@{self.at}"


@dataclasses.dataclass(frozen=True, kw_only=True)
class World:
    """What a healthy machine may suffer that is neither a loose seat nor play."""

    cable: float = 0.0
    """Strikes a second."""
    cable_body: int = -1
    mount: tuple[tuple[int, float, float], ...] = ()
    """Resonances of the accelerometer's mount: axis, frequency [Hz], damping ratio."""
    base: float = 0.0
    """Angle by which the base rocks on its bolts [rad]."""
    payload: float = 0.0
    """Mass at the tool that the reference did not have [kg]."""
    payload_at: tuple[float, float, float] = (0.0, 0.0, 0.0)
    press: float = 0.0
    """Peak acceleration of the ground from a neighbour's press [m/s2]."""
    press_every: float = 1.0
    hand: float = 0.0
    """Force of a hand on the tool [N]."""
    run: int = -1
    """The one run in which the press works or the hand pushes; every run if -1."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Played:
    """What happened in one run, before any sensor."""

    acceleration: Array
    """At the accelerometer, its frame, every time step (steps, 3)."""
    motor: Array
    """Angles of the rotors at the log's rate (samples, joints)."""
    link: Array
    """Angles of the links behind gear and play."""
    torque: Array
    """Torques as the controller knows them."""
    travel: Mapping[str, float]
    """Free travel that each fault used, over its clearance."""


class Machine(Protocol):
    """A machine on which a session is played."""

    sheet: Sheet

    def play(self, pose: Array, command: Array, rate: float, run: int) -> Played:
        """Move to a pose and follow a command given at a rate [Hz]."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Chances:
    """Generators of what stays with a machine and of what changes from day to day."""

    seed: tuple[int, ...]
    day: int

    def machine(self, part: int) -> np.random.Generator:
        """Same on every day."""
        return np.random.default_rng([*self.seed, 1, part])

    def today(self, part: int, run: int = 0) -> np.random.Generator:
        """Of the day and the run."""
        return np.random.default_rng([*self.seed, 2, part, self.day, run])


def rotation_off(rng: np.random.Generator, low: float, high: float) -> Array:
    """Quaternion of a small rotation about a random axis, by an angle of a range [degrees]."""
    axis, turn = rng.standard_normal(3), np.zeros(4)
    angle = float(np.radians(rng.uniform(low, high)))
    mujoco.mju_axisAngle2Quat(turn, axis / np.linalg.norm(axis), angle)
    return turn


def turned(quaternion: Any, by: Array) -> Array:
    """Product of two quaternions."""
    product = np.zeros(4)
    mujoco.mju_mulQuat(product, np.array(quaternion, float), by)
    return product


def resampled(
    command: Array, rate: float, sheet: Sheet, control_hz: float, before: Array
) -> tuple[Array, Array]:
    """Command and its rate of change as the servo sees them, each tick, after latency.

    Rows before the first command are `before`.
    """
    seconds = len(command) / rate
    taken = np.arange(int(seconds * sheet.command_hz)) / sheet.command_hz
    rows = np.minimum((taken * rate + 1e-6).astype(int), len(command) - 1)
    ticks = np.arange(round(seconds * control_hz)) / control_hz - sheet.latency
    if sheet.interpolated:
        late = ticks - 1 / sheet.command_hz
        found = np.stack([np.interp(late, taken, column) for column in command[rows].T], axis=1)
    else:
        place = np.clip((ticks * sheet.command_hz + 1e-6).astype(int), 0, len(rows) - 1)
        found = command[rows][place]
    found[ticks < 0] = before
    slope = (
        np.gradient(found, 1 / control_hz, axis=0) if sheet.interpolated else np.zeros_like(found)
    )
    return found, slope


def strikes(rng: np.random.Generator, count: int, rate: float, force: tuple[float, float]) -> Array:
    """Force of a cable that strikes now and then, every time step (count, 3)."""
    out, t = np.zeros((count, 3)), 0.0
    while rate > 0:
        t += rng.exponential(1 / rate)
        width = int(rng.uniform(0.8e-3, 2.5e-3) / STEP)
        start, way = int(t / STEP), rng.standard_normal(3)
        if start + width >= count:
            break
        pulse = rng.uniform(*force) * np.sin(np.pi * np.arange(width) / width)
        out[start : start + width] += np.outer(pulse, way / np.linalg.norm(way))
    return out


def ground(rng: np.random.Generator, count: int, world: World) -> Array:
    """Acceleration of the ground while a neighbour's press works, every time step (count, 3)."""
    out, t = np.zeros((count, 3)), rng.uniform(0, world.press_every)
    time = np.arange(count) * STEP
    tones = [
        (rng.uniform(18, 90), rng.uniform(0.05, 0.12), rng.standard_normal(3)) for _ in range(3)
    ]
    while t < count * STEP:
        after = np.maximum(time - t, 0)
        for hertz, ratio, way in tones:
            decay = np.exp(-2 * np.pi * hertz * ratio * after) * np.sin(2 * np.pi * hertz * after)
            out += world.press / 3 * rng.uniform(0.7, 1.3) * np.outer(decay, way)
        t += world.press_every * rng.uniform(0.95, 1.05)
    return out


def push(rng: np.random.Generator, count: int, force: float) -> Array:
    """Force of a hand that leans on the tool and trembles, every time step (count, 3)."""
    time = np.arange(count) * STEP
    lean = 0.6 + 0.4 * np.sin(2 * np.pi * rng.uniform(0.2, 0.6) * time + rng.uniform(0, 6))
    tremor = 0.12 * np.sin(2 * np.pi * rng.uniform(7, 11) * time)
    way = rng.standard_normal(3)
    return np.outer(force * (lean + tremor), way / np.linalg.norm(way))


class Simulated:
    """A machine of `machines.DESIGNS` as built, on one day."""

    def __init__(
        self, design: Design, chances: Chances, faults: tuple[Fault, ...] = (),
        world: World | None = None,
    ) -> None:  # fmt: skip
        self.design, self.sheet, self.chances = design, design.sheet, chances
        self.faults, self.world = faults, world or World()
        self._build()
        self._set_drives()

    def _build(self) -> None:
        """Compile the model: springs, faults and world as joints of their own."""
        design, rng, day = self.design, self.chances.machine(0), self.chances.today(0)
        n = len(design.links)
        size = rng.uniform(*design.mass_error, n) * rng.choice([-1, 1], n)
        reach = np.array([np.linalg.norm(link.position) + 0.1 for link in design.links])
        shift = rng.uniform(-0.03, 0.03, (n, 3)) * reach[:, None]
        spec = nominal_spec(design, 1 + size, shift)
        for list_of in (spec.actuators, spec.sensors):
            for each in list(list_of):
                spec.delete(each)
        spec.option.timestep = STEP
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        spec.option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
        spec.option.iterations, spec.option.tolerance = 40, 1e-9
        self._link_joints: list[list[str]] = []
        for link in design.links:
            self._add_joints(spec, link, {f.name: f for f in self.faults})
        last = spec.body(design.links[-1].body)
        if self.world.payload:
            last.add_geom(
                type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.02, 0, 0], mass=self.world.payload,
                pos=np.array(design.tool) + np.array(self.world.payload_at), contype=0,
                conaffinity=0,
            )  # fmt: skip
        if self.world.base:
            for name, axis in (("rock_x", [1, 0, 0]), ("rock_y", [0, 1, 0])):
                weight = sum(p.mass for link in design.links for p in link.parts)
                _stopped(spec.body(self.sheet.base), name, mujoco.mjtJoint.mjJNT_HINGE, axis,
                         self.world.base, 350.0, 0.25, 0.04 * weight)  # fmt: skip
        site = spec.site("tool")
        site.pos = np.array(site.pos) + 0.0015 * rng.standard_normal(3)
        site.quat = turned(site.quat, rotation_off(rng, 1.5, 4.0))
        if self.chances.day:
            site.quat = turned(site.quat, rotation_off(day, 0.3, 0.7))
        spec.add_sensor(
            name="acc", type=mujoco.mjtSensor.mjSENS_ACCELEROMETER,
            objtype=mujoco.mjtObj.mjOBJ_SITE, objname="tool",
        )  # fmt: skip
        for joint in self.sheet.joints:
            spec.add_actuator(name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        self.model = spec.compile()

    def _add_joints(self, spec: mujoco.MjSpec, link: Any, faults: Mapping[str, Fault]) -> None:
        body, joint = spec.body(link.body), spec.joint(link.joint)
        kind = joint.type
        joint.limited, joint.frictionloss, joint.solref_friction = 0, 1, [5e-4, 1]
        flex = body.add_joint(name=f"flex_{link.joint}", type=kind, axis=link.axis, frictionloss=1)
        flex.solref_friction, flex.armature = [5e-4, 1], 0.01 * link.armature
        names = [link.joint, f"flex_{link.joint}"]
        play = faults.get(f"backlash@{link.joint}")
        if play is not None:
            _stopped(body, f"fault_{play.name}", kind, link.axis, play.clearance, play.stop_hz,
                     play.stop_ratio, play.friction)  # fmt: skip
            names.append(f"fault_{play.name}")
        if link.bending_hz:
            across = np.array(link.parts[0].end if hasattr(link.parts[0], "end") else (0, 0, 0))
            body.add_joint(name=f"bend_{link.joint}", type=mujoco.mjtJoint.mjJNT_HINGE,
                           axis=link.bending_axis, pos=0.2 * across)  # fmt: skip
        seat = faults.get(f"structural_looseness@{link.body}")
        if seat is not None:
            _stopped(body, f"fault_{seat.name}", mujoco.mjtJoint.mjJNT_SLIDE, seat.direction,
                     seat.clearance, seat.stop_hz, seat.stop_ratio, seat.friction)  # fmt: skip
        self._link_joints.append(names)

    def _set_drives(self) -> None:
        """Springs from frequencies in the middle pose, servo gains, friction, mesh errors."""
        m, design, links = self.model, self.design, self.design.links
        rng, day, n = self.chances.machine(1), self.chances.today(1), len(self.design.links)
        other = 1.0 if self.chances.day else 0.0
        of = [m.joint(joint) for joint in self.sheet.joints]
        flex = [m.joint(f"flex_{joint}") for joint in self.sheet.joints]
        self._q, self._v = (np.array([getattr(j, a)[0] for j in of]) for a in ("qposadr", "dofadr"))
        self._fq, self._fv = (
            np.array([getattr(j, a)[0] for j in flex]) for a in ("qposadr", "dofadr")
        )
        self._sum = [[m.joint(k).qposadr[0] for k in names] for names in self._link_joints]
        data = mujoco.MjData(m)
        data.qpos[self._q] = [(link.low + link.high) / 2 for link in links]
        mujoco.mj_forward(m, data)
        full = np.zeros((m.nv, m.nv))
        mujoco.mj_fullM(m, data, full)
        inertia = np.diag(full)
        own = inertia[self._fv]  # of all beyond the gear
        hertz = np.array([link.gear_hz for link in links])
        hertz = (
            hertz
            * np.sqrt(1 + 0.15 * rng.uniform(-1, 1, n))
            * (1 + 0.015 * other * day.uniform(-1, 1, n))
        )
        self._k = (2 * np.pi * hertz) ** 2 * own
        self._limit = np.array(self.sheet.torque)
        for i, joint in enumerate(flex):
            m.jnt_stiffness[joint.id] = self._k[i]
            m.dof_damping[self._fv[i]] = (
                2 * rng.uniform(*design.gear_damping) * np.sqrt(self._k[i] * own[i])
            )
            m.dof_frictionloss[self._fv[i]] = design.hysteresis * self._limit[i]
            m.dof_armature[self._fv[i]] = 0.02 * own[i]
        for link in links:
            if link.bending_hz:
                bend = m.joint(f"bend_{link.joint}")
                dof = bend.dofadr[0]
                k = (2 * np.pi * link.bending_hz * rng.uniform(0.9, 1.1)) ** 2 * inertia[dof]
                m.jnt_stiffness[bend.id] = k
                m.dof_damping[dof] = 2 * rng.uniform(0.01, 0.03) * np.sqrt(k * inertia[dof])
        self._faults = {}
        for fault in self.faults:
            joint = m.joint(f"fault_{fault.name}")
            self._faults[fault.name] = (joint.qposadr[0], fault.clearance)
            if fault.preload:
                m.jnt_stiffness[joint.id] = SPRING
                m.qpos_spring[joint.qposadr[0]] = fault.clearance / 2 + fault.preload / SPRING
        rotor = np.array([link.armature for link in links]) * (1 + 0.08 * rng.uniform(-1, 1, n))
        m.dof_armature[self._v] = rotor
        total = (rotor + own) * (1 + 0.1 * rng.uniform(-1, 1, n))
        omega = 2 * np.pi * design.servo_hz * (1 + 0.1 * rng.uniform(-1, 1, n))
        if design.control == "cascade":
            self._kv, self._kp = total * omega, np.full(n, design.position_gain)
            self._ki = self._kv * omega / 4
        else:
            self._kp, self._kv = total * omega**2, 1.2 * total * omega
            self._ki = self._kp * 1.0
        coulomb = np.array([link.coulomb for link in links]) * (1 + 0.25 * rng.uniform(-1, 1, n))
        self._fc = coulomb * (1 + 0.15 * other * day.uniform(-1, 1, n))
        self._fs = self._fc * rng.uniform(0.1, 0.5, n)
        slide = np.array(self.sheet.slides)
        self._vs = np.where(slide, 0.01, 0.02) * rng.uniform(0.7, 1.5, n)
        viscous = np.array([link.viscous for link in links]) * (1 + 0.25 * rng.uniform(-1, 1, n))
        m.dof_damping[self._v] = viscous * (1 + 0.2 * other * day.uniform(-1, 1, n))
        self._weight = (1 + 0.05 * rng.uniform(-1, 1, n)) * design.gravity
        mesh = np.array([link.mesh for link in links]) * rng.uniform(0.5, 1.5, n)
        self._mesh = mesh * self._k
        teeth = np.array([link.teeth for link in links])
        self._teeth = np.where(slide, 2 * np.pi * teeth, teeth)
        self._phase = rng.uniform(0, 2 * np.pi, (2, n))
        self._gain = 1 + 0.08 * rng.uniform(-1, 1, n)
        mujoco.mj_setConst(m, data)

    def play(self, pose: Array, command: Array, rate: float, run: int) -> Played:
        """Move to a pose and follow a command given at a rate [Hz]."""
        m, d, design = self.model, mujoco.MjData(self.model), self.design
        rng, world = self.chances.today(3, run), self.world
        control, steps = design.control_hz, round(1 / (design.control_hz * STEP))
        target = np.array(pose, float)
        position = self.sheet.command == "position"
        before = target if position else np.zeros(len(target))
        wanted, slope = resampled(command, rate, self.sheet, control, before)
        ticks, settle = len(wanted), round(SETTLE * control)
        keep = max(1, round(control / self.sheet.log_hz))
        total = ticks * steps
        outer = np.zeros((total, 3))
        if world.cable:
            outer += strikes(rng, total, world.cable, self.sheet.strike)
        if world.hand and world.run in (run, -1):
            outer += push(rng, total, world.hand)
        shaken = ground(rng, total, world) if world.press and world.run in (run, -1) else None
        there = bool(outer.any())
        body = m.body(self.sheet.bodies[world.cable_body if world.cable else -1]).id
        address = m.sensor("acc").adr[0]
        d.qpos[self._q] = target
        mujoco.mj_forward(m, d)
        load = d.qfrc_bias[self._v].copy()
        d.qpos[self._fq] = -load / self._k
        integral = load * (1 - self._weight)
        last, slow = d.qpos[self._q].copy(), np.zeros(len(target))
        acceleration, n = np.zeros((total, 3)), len(target)
        motor, link, torque = (np.zeros((-(-ticks // keep), n)) for _ in range(3))
        path = np.zeros((ticks, len(self._faults)))
        places = [address for address, _ in self._faults.values()]
        fine = np.array([1e-8 if s else 2 * np.pi / 2**23 for s in self.sheet.slides])
        sample, dt = 0, 1 / control
        reference = target.copy()
        m.opt.gravity[:] = GRAVITY
        for k in range(-settle, ticks):
            q = np.round(d.qpos[self._q] / fine) * fine
            slow = 0.5 * slow + 0.5 * (q - last) / dt
            last = q
            asked, way = (wanted[k], slope[k]) if k >= 0 else (before, np.zeros(n))
            add: Any = 0.0
            if position:
                reference = asked
            elif self.sheet.command == "velocity":
                reference, way = reference + asked * dt, asked
            else:
                add = asked
            weight = d.qfrc_bias[self._v] * self._weight
            if design.control == "cascade":
                error = self._kp * (reference - q) + design.forward * way - slow
                integral = np.clip(integral + self._ki * error * dt, -self._limit, self._limit)
                tau = self._kv * error + integral + weight
            else:
                error = reference - q
                if position:
                    integral = np.clip(integral + self._ki * error * dt, -self._limit, self._limit)
                tau = self._kp * error + self._kv * (0.8 * way - slow) + integral + weight + add
            tau = np.clip(tau, -self._limit, self._limit)
            gear = self._k * d.qpos[self._fq]
            speed = np.abs(d.qvel[self._v]) / self._vs
            m.dof_frictionloss[self._v] = (
                self._fc + design.load_friction * np.abs(gear) + self._fs * np.exp(-(speed**2))
            )
            turn = self._teeth * d.qpos[self._q]
            d.qfrc_applied[self._fv] = self._mesh * (
                np.sin(turn + self._phase[0]) + 0.4 * np.sin(2 * turn + self._phase[1])
            )
            d.ctrl[:] = tau
            if k >= 0:
                path[k] = d.qpos[places]
                if k % keep == 0:
                    row = k // keep
                    motor[row] = d.qpos[self._q]
                    link[row] = [d.qpos[a].sum() for a in self._sum]
                    torque[row] = tau * self._gain if self.sheet.torques == "current" else -gear
            for _ in range(steps):
                if k >= 0:
                    if there:
                        d.xfrc_applied[body, :3] = outer[sample]
                    if shaken is not None:
                        m.opt.gravity[:] = GRAVITY - shaken[sample]
                mujoco.mj_step(m, d)
                if k >= 0:
                    acceleration[sample] = d.sensordata[address : address + 3]
                    sample += 1
        if not np.isfinite(acceleration).all() or np.abs(d.qvel).max() > 60:
            raise InvalidData(f"{self.sheet.name}: the simulation of run {run} diverged")
        travel = {
            name: float(np.ptp(path[:, i]) / clearance)
            for i, (name, (_, clearance)) in enumerate(self._faults.items())
        }
        return Played(
            acceleration=acceleration, motor=motor, link=link, torque=torque, travel=travel
        )


def _stopped(
    body: Any, name: str, kind: Any, axis: Any, clearance: float, hertz: float, ratio: float,
    friction: float,
) -> None:  # fmt: skip
    """Add a joint that moves freely between two stops."""
    omega = 2 * np.pi * hertz
    slide = kind == mujoco.mjtJoint.mjJNT_SLIDE
    body.add_joint(
        name=name, type=kind, axis=axis, range=[-clearance / 2, clearance / 2], limited=1,
        frictionloss=friction, damping=[15.0 if slide else 0.02, 0, 0],
        solref_limit=[-(omega**2), -2 * ratio * omega],
        solimp_limit=[0.95, 0.99, 1e-5, 0.5, 2], solref_friction=[4e-4, 1],
    )  # fmt: skip
