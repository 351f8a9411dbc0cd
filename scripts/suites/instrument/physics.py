"""Simulation of a machine as built, and of a session on it: gears, servo, friction, faults, world.

Each joint is a rotor and a link with a spring, hysteresis and a kinematic error between them; the
controller sees the rotor at its own rate. A loose seat is a slide with stops at the base of a
link, play a hinge or slide with stops behind the gear.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np

from loose_env.errors import InvalidData
from loose_env.typing import Array
from scripts.suites.instrument.machines import STEP, Design, Link, Sheet, nominal_spec

SETTLE = 0.7
"""Time at the pose before a run is recorded [s]."""
SPRING = 1e3
"""Stiffness of the long spring that preloads a seat [N/m]."""
GRAVITY = np.array([0.0, 0.0, -9.81])
HINGE, SLIDE = mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE
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
    turn = np.zeros(4)
    mujoco.mju_axisAngle2Quat(turn, _way(rng), float(np.radians(rng.uniform(low, high))))
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


def outside(
    world: World, sheet: Sheet, rng: np.random.Generator, count: int, run: int
) -> tuple[Array | None, Array | None]:
    """Force on the machine and acceleration of the ground, every time step (count, 3), or None."""
    force, ground, time = np.zeros((count, 3)), np.zeros((count, 3)), np.arange(count) * STEP
    now, t = world.run in (run, -1), 0.0
    while world.cable:  # strikes now and then
        t += rng.exponential(1 / world.cable)
        width, start = int(rng.uniform(0.8e-3, 2.5e-3) / STEP), int(t / STEP)
        if start + width >= count:
            break
        pulse = rng.uniform(*sheet.strike) * np.sin(np.pi * np.arange(width) / width)
        force[start : start + width] += np.outer(pulse, _way(rng))
    if world.hand and now:  # leans on the tool and trembles
        lean = 0.6 + 0.4 * np.sin(2 * np.pi * rng.uniform(0.2, 0.6) * time + rng.uniform(0, 6))
        tremor = 0.12 * np.sin(2 * np.pi * rng.uniform(7, 11) * time)
        force += np.outer(world.hand * (lean + tremor), _way(rng))
    if world.press and now:
        tones = [
            (2 * np.pi * rng.uniform(18, 90), rng.uniform(0.05, 0.12), _way(rng)) for _ in "abc"
        ]
        t = rng.uniform(0, world.press_every)
        while t < count * STEP:
            late = np.maximum(time - t, 0)
            for omega, ratio, way in tones:
                peak = 0.6 * world.press * rng.uniform(0.7, 1.3)
                ground += np.outer(peak * np.exp(-ratio * omega * late) * np.sin(omega * late), way)
            t += world.press_every * rng.uniform(0.95, 1.05)
    return (force if force.any() else None), (ground if ground.any() else None)


def _way(rng: np.random.Generator) -> Array:
    """Random direction."""
    way = rng.standard_normal(3)
    return way / np.linalg.norm(way)


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
        spec = nominal_spec(design, 1 + size, rng.uniform(-0.03, 0.03, (n, 3)) * reach[:, None])
        for each in [*spec.actuators, *spec.sensors]:
            spec.delete(each)
        spec.option.timestep = STEP
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        spec.option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
        spec.option.iterations, spec.option.tolerance = 40, 1e-9
        for link in design.links:
            self._add_joints(spec, link, {f.name: f for f in self.faults})
        if self.world.base:
            weight = sum(part.mass for link in design.links for part in link.parts)
            bolts = Fault(kind="", at="", index=0, clearance=self.world.base, stop_hz=350.0,
                          friction=0.04 * weight)  # fmt: skip
            for name, axis in (("rock_x", [1, 0, 0]), ("rock_y", [0, 1, 0])):
                _add_free(spec.body(self.sheet.base), name, HINGE, axis, bolts)
        site = spec.site("tool")
        site.pos = np.array(site.pos) + 0.0015 * rng.standard_normal(3)
        site.quat = turned(site.quat, rotation_off(rng, 1.5, 4.0))
        if self.chances.day:
            site.quat = turned(site.quat, rotation_off(day, 0.3, 0.7))
        spec.add_sensor(name="acc", type=mujoco.mjtSensor.mjSENS_ACCELEROMETER,
                        objtype=mujoco.mjtObj.mjOBJ_SITE, objname="tool")  # fmt: skip
        for joint in self.sheet.joints:
            spec.add_actuator(name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        self._inertia = self._inertia_of(spec.compile())  # gears know of no payload
        if self.world.payload:
            spec.body(design.links[-1].body).add_geom(
                type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.02, 0, 0], mass=self.world.payload,
                pos=np.array(design.tool) + np.array(self.world.payload_at), contype=0,
                conaffinity=0,
            )  # fmt: skip
        self.model = spec.compile()

    def _add_joints(self, spec: mujoco.MjSpec, link: Link, faults: Mapping[str, Fault]) -> None:
        body, joint = spec.body(link.body), spec.joint(link.joint)
        joint.limited, joint.frictionloss, joint.solref_friction = 0, 1, [5e-4, 1]
        flex = body.add_joint(name=f"flex_{link.joint}", type=joint.type, axis=link.axis)
        flex.frictionloss, flex.solref_friction, flex.armature = 1, [5e-4, 1], 0.01 * link.armature
        if play := faults.get(f"backlash@{link.joint}"):
            _add_free(body, f"fault_{play.name}", joint.type, link.axis, play)
        if link.bending_hz:
            across = 0.2 * np.array(getattr(link.parts[0], "end", (0, 0, 0)))
            bend = body.add_joint(name=f"bend_{link.joint}", axis=link.bending_axis, pos=across)
            bend.type = HINGE
        if seat := faults.get(f"structural_looseness@{link.body}"):
            _add_free(body, f"fault_{seat.name}", SLIDE, seat.direction, seat)

    def _inertia_of(self, model: mujoco.MjModel) -> Array:
        """Inertia at each degree of freedom in the middle pose."""
        data, full = mujoco.MjData(model), np.zeros((model.nv, model.nv))
        for link in self.design.links:
            data.joint(link.joint).qpos = (link.low + link.high) / 2
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, full)
        return np.diag(full).copy()

    def _set_drives(self) -> None:
        """Springs from frequencies in the middle pose, servo gains, friction, mesh errors."""
        m, design, links = self.model, self.design, self.design.links
        rng, day, n = self.chances.machine(1), self.chances.today(1), len(self.design.links)
        other = 1.0 if self.chances.day else 0.0

        def spread(size: float) -> Array:
            return 1 + size * rng.uniform(-1, 1, n)

        def daily(size: float) -> Array:
            return 1 + size * other * day.uniform(-1, 1, n)

        def of(name: str) -> Array:
            return np.array([getattr(link, name) for link in links], float)

        def places(what: str, prefix: str = "") -> Array:
            return np.array([getattr(m.joint(prefix + j), what)[0] for j in self.sheet.joints])

        self._q, self._v = places("qposadr"), places("dofadr")
        self._fq, self._fv = places("qposadr", "flex_"), places("dofadr", "flex_")
        own = self._inertia[self._fv]  # of all beyond the gear
        self._limit = np.array(self.sheet.torque)
        self._k = (2 * np.pi * of("gear_hz")) ** 2 * own * spread(0.15) * daily(0.03)
        m.jnt_stiffness[m.dof_jntid[self._fv]] = self._k
        ratio = rng.uniform(*design.gear_damping, n)
        m.dof_damping[self._fv] = 2 * ratio * np.sqrt(self._k * own)
        m.dof_frictionloss[self._fv] = design.hysteresis * self._limit
        m.dof_armature[self._fv] = 0.05 * own
        for link in links:
            if link.bending_hz:
                bend = m.joint(f"bend_{link.joint}")
                dof, omega = bend.dofadr[0], 2 * np.pi * link.bending_hz * rng.uniform(0.9, 1.1)
                m.jnt_stiffness[bend.id] = omega**2 * self._inertia[dof]
                m.dof_damping[dof] = 2 * rng.uniform(0.01, 0.03) * omega * self._inertia[dof]
        for fault in self.faults:
            press_shut(m, f"fault_{fault.name}", fault)
        rotor = of("armature") * spread(0.08)
        m.dof_armature[self._v] = rotor
        total, rate = (rotor + own) * spread(0.1), 2 * np.pi * design.servo_hz * spread(0.1)
        if design.control == "cascade":
            self._kv, self._kp = total * rate, np.full(n, design.position_gain)
            self._ki = self._kv * rate / 4
        else:
            self._kp, self._kv = total * rate**2, 1.2 * total * rate
            self._ki = self._kp
        slide = np.array(self.sheet.slides)
        self._fc = of("coulomb") * spread(0.25) * daily(0.15)
        self._fs = self._fc * rng.uniform(0.1, 0.5, n)
        self._vs = np.where(slide, 0.01, 0.02) * rng.uniform(0.7, 1.5, n)
        m.dof_damping[self._v] = of("viscous") * spread(0.25) * daily(0.2)
        self._weight = spread(0.05) * design.gravity
        self._mesh = of("mesh") * spread(0.5) * self._k
        self._teeth = of("teeth") * np.where(slide, 2 * np.pi, 1.0)
        rough = rng.uniform(*design.roughness) * own * of("acceleration")
        self._rough = rough / (0.15 * of("speed"))  # over speed
        self._phase = rng.uniform(0, 2 * np.pi, (2, n))
        self._gain = spread(0.08)
        mujoco.mj_setConst(m, mujoco.MjData(m))

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
        force, ground = outside(world, self.sheet, rng, total, run)
        body = m.body(self.sheet.bodies[world.cable_body]).id
        address = m.sensor("acc").adr[0]
        d.qpos[self._q] = target
        mujoco.mj_forward(m, d)
        load = d.qfrc_bias[self._v].copy()
        d.qpos[self._fq] = -load / self._k
        integral = load * (1 - self._weight)
        last, slow = d.qpos[self._q].copy(), np.zeros(len(target))
        acceleration, n = np.zeros((total, 3)), len(target)
        motor, link, torque = (np.zeros((-(-ticks // keep), n)) for _ in range(3))
        path = np.zeros((ticks, len(self.faults)))
        places = [m.joint(f"fault_{fault.name}").qposadr[0] for fault in self.faults]
        behind = [
            [m.jnt_qposadr[j] for j in range(m.njnt) if m.joint(j).name in
             (joint, f"flex_{joint}", f"fault_backlash@{joint}")]
            for joint in self.sheet.joints
        ]  # fmt: skip
        fine = np.array([1e-8 if s else 2 * np.pi / 2**23 for s in self.sheet.slides])
        sample, dt = 0, 1 / control
        reference = target.copy()
        m.opt.gravity[:] = GRAVITY
        qpos, qvel, bias, applied, ctrl = d.qpos, d.qvel, d.qfrc_bias, d.qfrc_applied, d.ctrl
        shown, pushed = d.sensordata[address : address + 3], d.xfrc_applied[body, :3]
        friction, low = m.dof_frictionloss, -self._limit

        def clipped(values: Array) -> Array:  # np.clip takes thrice as long
            return np.asarray(np.minimum(np.maximum(values, low), self._limit))

        for k in range(-settle, ticks):
            q = np.rint(qpos[self._q] / fine) * fine
            slow = 0.5 * slow + 0.5 * (q - last) / dt
            last = q
            asked, way = (wanted[k], slope[k]) if k >= 0 else (before, np.zeros(n))
            add = asked if self.sheet.command == "torque" else np.zeros(n)
            if position:
                reference = asked
            elif self.sheet.command == "velocity":
                reference, way = reference + asked * dt, asked
            weight = bias[self._v] * self._weight
            if design.control == "cascade":
                error = self._kp * (reference - q) + design.forward * way - slow
                integral = clipped(integral + self._ki * error * dt)
                tau = self._kv * error + integral + weight
            else:
                error = reference - q
                if position:
                    integral = clipped(integral + self._ki * error * dt)
                tau = self._kp * error + self._kv * (0.8 * way - slow) + integral + weight + add
            tau = clipped(tau)
            gear = self._k * qpos[self._fq]
            speed = np.abs(qvel[self._v]) / self._vs
            friction[self._v] = (
                self._fc + design.load_friction * np.abs(gear) + self._fs * np.exp(-(speed**2))
            )
            turn = self._teeth * qpos[self._q]
            applied[self._fv] = self._mesh * (
                np.sin(turn + self._phase[0]) + 0.4 * np.sin(2 * turn + self._phase[1])
            ) + self._rough * qvel[self._v] * rng.standard_normal(n)
            ctrl[:] = tau
            if k >= 0:
                path[k] = qpos[places]
                if k % keep == 0:
                    row = k // keep
                    motor[row] = qpos[self._q]
                    link[row] = [qpos[a].sum() for a in behind]
                    torque[row] = tau * self._gain if self.sheet.torques == "current" else -gear
            for _ in range(steps):
                if k >= 0 and force is not None:
                    pushed[:] = force[sample]
                if k >= 0 and ground is not None:
                    m.opt.gravity[:] = GRAVITY - ground[sample]
                mujoco.mj_step(m, d)
                if k >= 0:
                    acceleration[sample] = shown
                    sample += 1
        if not np.isfinite(acceleration).all() or np.abs(d.qvel).max() > 60:
            raise InvalidData(f"{self.sheet.name}: the simulation of run {run} diverged")
        travel = {
            fault.name: float(np.ptp(path[:, i]) / fault.clearance)
            for i, fault in enumerate(self.faults)
        }
        return Played(acceleration=acceleration, motor=motor, link=link, torque=torque,
                      travel=travel)  # fmt: skip


def press_shut(model: mujoco.MjModel, name: str, fault: Fault) -> None:
    """Preload the seat's joint with a long spring."""
    if fault.preload:
        joint = model.joint(name)
        model.jnt_stiffness[joint.id] = SPRING
        model.qpos_spring[joint.qposadr[0]] = fault.clearance / 2 + fault.preload / SPRING


def _add_free(body: Any, name: str, kind: Any, axis: Any, fault: Fault) -> None:
    """Add a joint that moves freely between two stops."""
    omega = 2 * np.pi * fault.stop_hz
    body.add_joint(
        name=name, type=kind, axis=axis, range=[-fault.clearance / 2, fault.clearance / 2],
        limited=1, frictionloss=fault.friction, damping=[15.0 if kind == SLIDE else 0.02, 0, 0],
        solref_limit=[-(omega**2), -2 * fault.stop_ratio * omega],
        solimp_limit=[0.95, 0.99, 1e-5, 0.5, 2], solref_friction=[4e-4, 1],
    )  # fmt: skip
