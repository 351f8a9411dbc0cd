"""The true arm in time: a fixed-step Runge-Kutta method, and chains put together."""

from __future__ import annotations

import dataclasses

import numpy as np
from numba import njit
from numpy.typing import NDArray

from loose_env.typing import Array
from scripts.suites.gap.arms import GRAVITY, Figures
from scripts.suites.gap.dynamics import (
    ACTUATOR,
    BODY,
    DAMPING,
    GAIN,
    KP,
    KV,
    LAWS,
    LIMIT,
    WORK,
    add_tool_force,
    add_weight,
    drive_torque,
    encoder,
    forward,
    gear_friction,
    joint_force,
    mass_and_bias,
    solve,
    tool_acceleration,
)

SAMPLE = 1e-3
"""Time between two samples [s]."""
SETTLE = 1.2
"""Time for which the first command is held before the recording starts [s]."""


@dataclasses.dataclass(kw_only=True)
class System:
    """A true arm in arrays: n drives, N >= n degrees of freedom."""

    bodies: Array
    """Figures of the bodies, of shape (N, BODY)."""
    laws: Array
    """Laws in the degrees of freedom, of shape (N, LAWS)."""
    drives: Array
    """Drives in the order of the joints, of shape (n, ACTUATOR)."""
    gravity: Array
    """Acceleration of free fall in the world, of shape (3,) [m/s²]."""
    tool: Array
    """The tool in the last body's frame, of shape (3,) [m]."""
    cable: Array = dataclasses.field(default_factory=lambda: np.zeros(5))
    """A spring over two joints: their degrees of freedom, ratio, stiffness, rest; shape (5,)."""
    fan: Array = dataclasses.field(default_factory=lambda: np.zeros(5))
    """A force at the tool in its frame (3) [N], its frequency [Hz] and phase [rad]; shape (5,)."""
    proximal: NDArray[np.int64] = dataclasses.field(default_factory=lambda: np.zeros(0, np.int64))
    """Body that carries the proximal end of each link, of shape (n,)."""
    distal: NDArray[np.int64] = dataclasses.field(default_factory=lambda: np.zeros(0, np.int64))
    """Body that carries the distal end of each link, of shape (n,)."""

    def copy(self) -> System:
        """Another system with the same figures."""
        return System(**{f.name: getattr(self, f.name).copy() for f in dataclasses.fields(self)})

    @property
    def joint_dofs(self) -> NDArray[np.int64]:
        """Degree of freedom on the motor's side of each joint, of shape (n,)."""
        return self.drives[:, 0].astype(np.int64)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Trace:
    """What happened, without noise, at every sample (or at every step inside a sample)."""

    position: Array
    """What perfect encoders say, of shape (T, n) [rad or m]."""
    velocity: Array
    """Velocities at the motors, of shape (T, n)."""
    acceleration: Array
    """Proper acceleration of the tool in its frame, of shape (T, 3) [m/s²]."""
    torque: Array
    """Torques that the drives ask for, of shape (T, n) [N m or N]."""
    energy: Array
    """Kinetic and potential energy, of shape (T,) [J]."""


@njit(cache=True, fastmath=False)
def _derivative(  # type: ignore[no-untyped-def]
    bodies, laws, drives, gravity, tool, cable, fan, powered, command, time, q, v, lag, z,
    work, mass, force, torque, rate, a, dlag, dz,
):  # fmt: skip
    n = q.shape[0]
    forward(bodies, q, v, gravity, work)
    mass_and_bias(bodies, work, mass, force)
    bias = force.copy()
    for k in range(n):
        force[k] = joint_force(laws[k], q[k], v[k], z[k], time) - force[k]
        dz[k] = 0.0
        if laws[k, 19] != 0.0:
            dz[k] = (v[k] - 0.5 * (abs(v[k]) * z[k] + v[k] * abs(z[k]))) / laws[k, 20]
    load = 0.0
    for j in range(drives.shape[0]):
        k = int(drives[j, 0])
        dlag[j] = 0.0
        target = command[j]
        if drives[j, 5] > 0.0:
            target = lag[j]
            dlag[j] = (command[j] - lag[j]) / drives[j, 5]
        torque[j] = 0.0
        if powered:
            torque[j] = drive_torque(drives[j], target, q[k], v[k])
        load += abs(torque[j]) / drives[j, 3]
    for j in range(drives.shape[0]):
        k = int(drives[j, 0])
        given = torque[j] * drives[j, 4] / (1.0 + drives[j, 9] * load)
        force[k] += given
        if drives[j, 10] > 0.0:
            force[k] += gear_friction(drives[j], given, bias[k], v[k])
    for k in range(n):
        if bodies[k, 21] != 0.0:
            add_weight(bodies, work, k, -bodies[k, 21], gravity, force)
    if cable[3] != 0.0:
        i, j = int(cable[0]), int(cable[1])
        pull = cable[3] * (q[i] + cable[2] * q[j] - cable[4])
        force[i] -= pull
        force[j] -= cable[2] * pull
    if fan[3] > 0.0:
        swing = np.sin(2.0 * np.pi * fan[3] * time + fan[4])
        local = np.array([fan[0] * swing, fan[1] * swing, fan[2] * swing])
        add_tool_force(work, tool, local, force)
    solve(mass, force, a)


@njit(cache=True, fastmath=False)
def _between(commands, j, x):  # type: ignore[no-untyped-def]
    """Command of drive j at x samples, on a straight line between two."""
    x = min(max(x, 0.0), commands.shape[0] - 1.0)
    first = min(int(x), commands.shape[0] - 2)
    return commands[first, j] + (x - first) * (commands[first + 1, j] - commands[first, j])


@njit(cache=True, fastmath=False)
def _run(  # type: ignore[no-untyped-def]
    bodies, laws, drives, gravity, tool, cable, fan, release, commands, q, v, settle, inside,
    every, straight,
):  # fmt: skip
    dofs, n = q.shape[0], drives.shape[0]
    samples = commands.shape[0]
    step = 1e-3 / inside
    rows = samples * inside // every
    out = np.zeros((rows, 3 * n + 4))
    work = np.zeros((dofs, 40))
    mass = np.zeros((dofs, dofs))
    force, torque, rate = np.zeros(dofs), np.zeros(n), np.zeros(dofs)
    command, there, lag = commands[0].copy(), commands[0].copy(), commands[0].copy()
    z = np.zeros(dofs)
    q1, v1, z1, lag1 = q.copy(), v.copy(), z.copy(), lag.copy()
    a = np.zeros((4, dofs))
    va = np.zeros((4, dofs))
    dz = np.zeros((4, dofs))
    dlag = np.zeros((4, n))
    acceleration = np.zeros(3)
    row = 0
    for i in range(-settle * inside, samples * inside):
        time = i * step
        on = i < release * inside
        for j in range(n):
            # the command is held from sample to sample; its mean over this step, delayed
            x = max((time - drives[j, 6]) / 1e-3, 0.0)
            first = int(x + 1e-9)
            over = x + 1.0 / inside - (first + 1)
            share = min(max(over * inside, 0.0), 1.0)
            if share < 1e-6:
                share = 0.0
            now = commands[min(first, samples - 1), j]
            there[j] = now
            command[j] = now + share * (commands[min(first + 1, samples - 1), j] - now)
            if straight:
                there[j] = _between(commands, j, (time - drives[j, 6]) / 1e-3)
        if i >= 0 and i % every == 0 and row < rows:
            # sensors read what is there at their moment, not what comes within the step
            _derivative(
                bodies, laws, drives, gravity, tool, cable, fan, on, there, time, q, v, lag,
                z, work, mass, force, torque, rate, a[0], dlag[0], dz[0],
            )  # fmt: skip
            tool_acceleration(work, tool, a[0], acceleration)
            for j in range(n):
                k = int(drives[j, 0])
                error, slope = encoder(drives[j], q[k])
                out[row, j] = q[k] + error
                out[row, n + j] = v[k] * (1.0 + slope)
                out[row, 2 * n + 3 + j] = torque[j]
            out[row, 2 * n] = acceleration[0]
            out[row, 2 * n + 1] = acceleration[1]
            out[row, 2 * n + 2] = acceleration[2]
            # the solver leaves the upper half of the mass matrix; its diagonal is a factor's
            energy = 0.0
            for k in range(dofs):
                for j in range(k):
                    energy += v[j] * mass[j, k] * v[k]
                square = mass[k, k] * mass[k, k]
                for j in range(k):
                    square += mass[k, j] * mass[k, j]
                energy += 0.5 * square * v[k] * v[k]
                s, b = work[k], bodies[k]
                for d in range(3):
                    com = s[9 + d] + s[3 * d] * b[8] + s[3 * d + 1] * b[9] + s[3 * d + 2] * b[10]
                    energy -= b[7] * gravity[d] * com
            out[row, 3 * n + 3] = energy
            row += 1
        for stage in range(4):
            if stage == 0:
                q1[:] = q
                v1[:] = v
                z1[:] = z
                lag1[:] = lag
                t = time
            else:
                c = step if stage == 3 else 0.5 * step
                t = time + c
                for k in range(dofs):
                    q1[k] = q[k] + c * va[stage - 1, k]
                    v1[k] = v[k] + c * a[stage - 1, k]
                    z1[k] = z[k] + c * dz[stage - 1, k]
                for j in range(n):
                    lag1[j] = lag[j] + c * dlag[stage - 1, j]
            if straight:
                for j in range(n):
                    command[j] = _between(commands, j, (t - drives[j, 6]) / 1e-3)
            _derivative(
                bodies, laws, drives, gravity, tool, cable, fan, on, command, t, q1, v1, lag1,
                z1, work, mass, force, torque, rate, a[stage], dlag[stage], dz[stage],
            )  # fmt: skip
            va[stage] = v1
        for k in range(dofs):
            q[k] += step / 6.0 * (va[0, k] + 2.0 * va[1, k] + 2.0 * va[2, k] + va[3, k])
            v[k] += step / 6.0 * (a[0, k] + 2.0 * a[1, k] + 2.0 * a[2, k] + a[3, k])
            z[k] += step / 6.0 * (dz[0, k] + 2.0 * dz[1, k] + 2.0 * dz[2, k] + dz[3, k])
        for j in range(n):
            lag[j] += step / 6.0 * (dlag[0, j] + 2.0 * dlag[1, j] + 2.0 * dlag[2, j] + dlag[3, j])
    return out


def simulate(
    system: System,
    commands: Array,
    *,
    inside: int = 10,
    release: int | None = None,
    settle: float = SETTLE,
    fine: bool = False,
    straight: bool = False,
    start: tuple[Array, Array] | None = None,
) -> Trace:
    """Run an arm through a list of commands, a millisecond apart."""
    assert system.bodies.shape[1] == BODY and system.laws.shape[1] == LAWS
    assert system.drives.shape[1] == ACTUATOR and WORK == 40
    n = system.drives.shape[0]
    if start is None:
        q = np.zeros(system.bodies.shape[0])
        q[system.joint_dofs] = commands[0] - system.drives[:, 7]
        v = np.zeros_like(q)
    else:
        q, v = start[0].copy(), start[1].copy()
    out = _run(
        system.bodies, system.laws, system.drives, system.gravity, system.tool, system.cable,
        system.fan, len(commands) if release is None else release,
        np.ascontiguousarray(commands), q, v, round(settle / SAMPLE), inside,
        1 if fine else inside, straight,
    )  # fmt: skip
    return Trace(
        position=out[:, :n],
        velocity=out[:, n : 2 * n],
        acceleration=out[:, 2 * n : 2 * n + 3],
        torque=out[:, 2 * n + 3 : 3 * n + 3],
        energy=out[:, 3 * n + 3],
    )


TOLERANCE = 0.03
"""Largest relative error of the nominal masses, inertias, dampings, gains and rotors."""
LEAST_ERROR = 0.01
"""Smallest relative error that a true arm has."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Factors:
    """True over nominal figures; each of shape (n,)."""

    mass: Array
    inertia: Array
    armature: Array
    damping: Array
    kp: Array
    kv: Array

    @classmethod
    def ones(cls, joints: int) -> Factors:
        """An arm that is exactly the nominal one."""
        return cls(**{name: np.ones(joints) for name in FACTORS})

    @classmethod
    def draw(
        cls,
        joints: int,
        rng: np.random.Generator,
        *,
        least: float = LEAST_ERROR,
        most: float = TOLERANCE,
    ) -> Factors:
        """Errors of random sign, by default of 1 to 3 %."""
        return cls(
            **{
                name: 1 + rng.uniform(least, most, joints) * rng.choice([-1, 1], joints)
                for name in FACTORS
            }
        )

    def changed(self, name: str, joint: int, by: float) -> Factors:
        """The same factors with one of them moved by `by`."""
        values = getattr(self, name).copy()
        values[joint] += by
        return dataclasses.replace(self, **{name: values})

    def flat(self) -> Array:
        """All factors, of shape (6 n,), in the order of `FACTORS`."""
        return np.concatenate([getattr(self, name) for name in FACTORS])


FACTORS = tuple(field.name for field in dataclasses.fields(Factors))
"""Names of the factors: the nuisance parameters of every recording."""


def body_row(
    kind: str, axis: object, offset: object, mass: float, com: object, inertia: Array, rotor: float
) -> Array:
    """One row of `System.bodies`; `inertia` is of shape (3, 3) about the centre of mass."""
    row = np.zeros(BODY)
    row[0] = float(kind == "slide")
    row[1:4], row[4:7], row[7], row[8:11] = axis, offset, mass, com  # type: ignore[call-overload]
    row[11:20] = inertia.ravel()
    row[20] = rotor
    return row


def build(figures: Figures, factors: Factors) -> System:
    """The arm without any missing effect."""
    bodies, laws, drives = [], [], []
    for i, link in enumerate(figures.links):
        bodies.append(
            body_row(
                link.kind, link.axis, link.offset, link.mass * factors.mass[i], link.com,
                np.diag(link.inertia) * factors.inertia[i], link.armature * factors.armature[i],
            )
        )  # fmt: skip
        law = np.zeros(LAWS)
        law[DAMPING] = link.damping * factors.damping[i]
        laws.append(law)
        drive = np.zeros(ACTUATOR)
        drive[0] = i
        drive[KP], drive[KV] = link.kp * factors.kp[i], link.kv * factors.kv[i]
        drive[LIMIT], drive[GAIN] = link.limit, 1.0
        drives.append(drive)
    return System(
        bodies=np.array(bodies),
        laws=np.array(laws),
        drives=np.array(drives),
        gravity=np.array([0.0, 0.0, -GRAVITY]),
        tool=np.array(figures.links[-1].end, dtype=float),
        proximal=np.arange(figures.joints),
        distal=np.arange(figures.joints),
    )


def _insert(system: System, at: int, body: Array, law: Array) -> None:
    """Put a row in front of position `at`; every index to the rows behind moves on."""
    system.bodies = np.insert(system.bodies, at, body, axis=0)
    system.laws = np.insert(system.laws, at, law, axis=0)
    system.drives[system.drives[:, 0] >= at, 0] += 1
    system.cable[:2][system.cable[:2] >= at] += 1
    system.proximal[system.proximal >= at] += 1
    system.distal[system.distal >= at] += 1


def free_link(system: System, link: int, kind: str, axis: Array) -> int:
    """Set a link on an extra joint between it and the motor of its joint."""
    at = int(system.proximal[link])
    carried = system.bodies[at].copy()
    carried[0] = float(kind == "slide")
    carried[1:4], carried[4:7], carried[20] = axis, 0.0, 0.0
    system.bodies[at, 7:20] = 0.0
    one_body = system.distal[link] == at
    _insert(system, at + 1, carried, np.zeros(LAWS))
    system.proximal[link] = at + 1
    if one_body:
        system.distal[link] = at + 1
    return at + 1


def free_base(system: System, axis: Array) -> int:
    """Set the whole arm on a hinge through the world's origin."""
    base = body_row("hinge", axis, np.zeros(3), 0.0, np.zeros(3), np.zeros((3, 3)), 0.0)
    _insert(system, 0, base, np.zeros(LAWS))
    return 0


def split_link(system: System, link: int, point: Array, axis: Array, share: float) -> int:
    """Cut a link in two at a point and join the parts by a hinge; mass and inertia are kept."""
    at = int(system.proximal[link])
    whole = system.bodies[at]
    mass, com, inertia = whole[7], whole[8:11].copy(), whole[11:20].reshape(3, 3).copy()
    near = share * mass
    length = float(np.linalg.norm(point))
    along = point / length
    bar = near * length**2 / 12 * (np.eye(3) - np.outer(along, along)) + share * inertia[
        0, 0
    ] * np.outer(along, along)
    near_com = point / 2
    far = mass - near
    far_com = (mass * com - near * near_com) / far
    rest = inertia - bar - _shifted(near, near_com - com) - _shifted(far, far_com - com)
    if np.linalg.eigvalsh(rest).min() <= 0:
        raise ValueError("the link is no bar: nothing is left for its distal part")
    whole[7], whole[8:11], whole[11:20] = near, near_com, bar.ravel()
    end = int(system.distal[link])
    assert end == at, "a link is cut once"
    if end + 1 < len(system.bodies):
        system.bodies[end + 1, 4:7] -= point
    else:
        system.tool = system.tool - point
    row = body_row("hinge", axis, point, far, far_com - point, rest, 0.0)
    _insert(system, end + 1, row, np.zeros(LAWS))
    system.distal[link] = end + 1
    return end + 1


def _shifted(mass: float, arm: Array) -> Array:
    """Inertia of a point mass at `arm`, of shape (3, 3)."""
    return mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))


def add_mass(system: System, body: int, mass: float, at: Array) -> None:
    """Fix a point mass (it may be negative) to a body, in place."""
    row = system.bodies[body]
    total = row[7] + mass
    com = (row[7] * row[8:11] + mass * at) / total
    inertia = (
        row[11:20].reshape(3, 3) + _shifted(row[7], row[8:11] - com) + _shifted(mass, at - com)
    )
    row[7], row[8:11], row[11:20] = total, com, inertia.ravel()


def mass_matrix(system: System, joints: Array) -> Array:
    """Mass matrix with the joints at given positions and the extra ones at rest, (N, N)."""
    dofs = len(system.bodies)
    q = np.zeros(dofs)
    q[system.joint_dofs] = joints
    work = np.zeros((dofs, WORK))
    mass, bias = np.zeros((dofs, dofs)), np.zeros(dofs)
    forward(system.bodies, q, np.zeros(dofs), system.gravity, work)
    mass_and_bias(system.bodies, work, mass, bias)
    return mass


def felt_inertia(system: System, dof: int, joints: Array) -> float:
    """Inertia that a force in one degree of freedom feels, all others free."""
    return 1.0 / float(np.linalg.inv(mass_matrix(system, joints))[dof, dof])
