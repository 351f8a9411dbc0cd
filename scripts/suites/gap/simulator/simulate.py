"""The arm in time: a fixed-step Runge-Kutta method of fourth order with steps inside a sample."""

from __future__ import annotations

import dataclasses

import numpy as np
from numba import njit
from numpy.typing import NDArray

from loose_env.typing import Array
from scripts.suites.gap.simulator.dynamics import (
    BODY,
    WORK,
    add_tool_force,
    add_weight,
    forward,
    mass_and_bias,
    solve,
    tool_acceleration,
)
from scripts.suites.gap.simulator.laws import (
    ACTUATOR,
    LAWS,
    drive_torque,
    encoder,
    gear_friction,
    joint_force,
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
    """Run an arm through a list of commands, a millisecond apart.

    Parameters
    ----------
    system : System
        The arm.
    commands : Array
        Positions commanded, of shape (T, n) [rad or m]; the first is held while the arm settles.
    inside : int
        Steps inside a sample.
    release : int, optional
        Sample at which the drives are switched off; never if not given.
    settle : float
        Time given to settle [s].
    fine : bool
        Return every step instead of every sample.
    straight : bool
        Go in straight lines from command to command instead of holding each: torques measured
        by a drive that does so have no steps.
    start : (Array, Array), optional
        Positions and velocities at the start of settling, of shape (N,); at rest at the first
        command if not given.

    Returns
    -------
    Trace
    """
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
