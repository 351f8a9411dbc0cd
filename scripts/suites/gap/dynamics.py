"""True arm as arrays: built, altered by extra joints and masses, and integrated in time."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from loose_env.typing import Array
from scripts.suites.gap.arms import GRAVITY, Figures

# Columns of a degree of freedom's row of laws.
DAMPING, THINNING, EXTRA = 0, 1, 21
"""Viscous coefficient; speed at which a further coefficient has thinned by a tenth, and it."""
FRICTION, BUMP, STRIBECK_SPEED, SMOOTH_SPEED, WARM_TIME = 2, 3, 4, 5, 6
"""Coulomb torque, static over Coulomb torque minus one, Stribeck speed, width of the tangent,
time in which the friction warms away (0: never)."""
DRAG = 7
"""Coefficient of speed squared."""
STIFFNESS, REST, PROGRESS = 8, 9, 10
"""Spring, its rest, and one over the square of the stretch that doubles its stiffness / 3."""
GAP_LOW, GAP_HIGH, HERTZ, CROSSLEY = 11, 12, 13, 14
"""Ends of the free travel, stiffness of the stops (force / travel^1.5), their dissipation."""
RIPPLE, ORDER, PHASE, SECOND = 15, 16, 17, 18
"""Amplitude, periods per unit of travel times 2 pi, phase, share of the second harmonic."""
ASYMMETRY = 22
"""Excess of the friction in the positive direction over the mean of both directions."""
GRAIN = 23
"""Waves per turn by which the friction varies from none to twice its mean (0: not); their phase."""
SLACK_FORCE, SLACK, ELASTIC = 19, 20, 25
"""Dry friction of an element that is coupled with slack and an elastic way."""
LAWS = 26

# Columns of an actuator's row.
DOF, KP, KV, LIMIT, GAIN, LAG, DELAY, OFFSET, DEAD, SAG = 0, 1, 2, 3, 4, 5, 6, 7, 8, 9
"""Driven degree of freedom, gains, largest torque, torque over commanded torque, time constant
and delay of the command, error of the encoder, dead zone of the position error, fall of the gain
with the load of all drives."""
LOADED, LOADED_BUMP, LOADED_SPEED, LOADED_SMOOTH = 10, 11, 12, 13
"""Friction of the gear over the torque of the drive; static over that, minus one; Stribeck speed;
width of the tangent."""
BACK_EMF = 14
"""Part of the velocity gain that is the motor's back-EMF: it acts beyond the limit of the torque,
which is that of the voltage."""
ECCENTRIC_SINE, ECCENTRIC_COSINE = 15, 16
"""Error of the encoder that is periodic in the turn of the joint."""
LOADED_EXTERNAL = 17
"""Friction of what is behind the gear over the torque of the load."""
LINK_SIDE = 18
"""Extra degree of freedom that an encoder on the link's side reads too; -1 on the motor's side."""
SPEED_LIMIT = 19
"""Largest speed at which the drive follows its command (0: any)."""
ACTUATOR = 20


@njit(cache=True, fastmath=False)
def joint_force(law, q, v, z, time):  # type: ignore[no-untyped-def]
    """Passive force of one degree of freedom."""
    viscous = law[0] * v
    if law[21] != 0.0:
        viscous += law[21] * v / (1.0 + abs(v) / law[1]) ** 0.152
    force = -viscous - law[7] * v * abs(v)
    if law[2] != 0.0:
        bump = 0.0
        if law[3] != 0.0:
            x = v / law[4]
            bump = law[3] * np.exp(-x * x)
        fade = 1.0
        if law[6] > 0.0 and time > 0.0:
            fade = np.exp(-time / law[6])
        side = 1.0 + law[22] if v > 0.0 else 1.0 - law[22]
        if law[23] != 0.0:
            fade *= 1.0 + np.cos(law[23] * q + law[24])
        force -= law[2] * fade * side * (1.0 + bump) * np.tanh(v / law[5])
    if law[8] != 0.0:
        x = q - law[9]
        force -= law[8] * x * (1.0 + law[10] * x * x)
    if law[13] > 0.0:
        if q > law[12]:
            depth = q - law[12]
            push = law[13] * depth * np.sqrt(depth) * (1.0 + law[14] * v)
            if push > 0.0:
                force -= push
        elif q < law[11]:
            depth = law[11] - q
            push = law[13] * depth * np.sqrt(depth) * (1.0 - law[14] * v)
            if push > 0.0:
                force += push
    if law[15] != 0.0:
        x = law[16] * q + law[17]
        force += law[15] * (np.sin(x) + law[18] * np.sin(2.0 * x + 0.7))
    if law[19] != 0.0:
        stretch = abs(q - z) - 0.5 * law[20]
        force -= law[19] * np.sign(q - z) * min(max(stretch / law[25], 0.0), 1.0)
    return force


@njit(cache=True, fastmath=False)
def encoder(row, q):  # type: ignore[no-untyped-def]
    """Error of an encoder and its derivative by the angle, of a wheel that turns off its centre."""
    error = row[7] + row[15] * np.sin(q) + row[16] * np.cos(q)
    return error, row[15] * np.cos(q) - row[16] * np.sin(q)


@njit(cache=True, fastmath=False)
def drive_torque(row, command, q, v):  # type: ignore[no-untyped-def]
    """Torque that a drive asks for: position servo with a dead zone, and the limit of its motor."""
    error, slope = encoder(row, q)
    error = command - q - error
    if row[8] > 0.0:
        if error > row[8]:
            error -= row[8]
        elif error < -row[8]:
            error += row[8]
        else:
            error = 0.0
    torque = row[1] * error - (row[2] - row[14]) * v * (1.0 + slope)
    if torque > row[3]:
        torque = row[3]
    elif torque < -row[3]:
        torque = -row[3]
    return torque - row[14] * v


@njit(cache=True, fastmath=False)
def gear_friction(row, torque, load, v):  # type: ignore[no-untyped-def]
    """Friction of teeth under the torques of a drive and of its load, against the motion."""
    x = v / row[12]
    size = row[10] * abs(torque) * (1.0 + row[11] * np.exp(-x * x)) + row[17] * abs(load)
    return -size * np.tanh(v / row[13])


BODY = 24
"""Length of a body's row: see the columns below."""
KIND, AXIS, ORIGIN, MASS, COM, INERTIA, ARMATURE = 0, 1, 4, 7, 8, 11, 20
"""First columns: kind (0 hinge, 1 slide), axis (3), offset (3), mass, centre of mass (3), inertia
matrix by rows (9), rotor inertia."""
CARRIED = 21
"""Column of the share of a body's weight that something else carries."""

WORK = 40
"""Length of a body's row of working space."""
_R, _O, _W, _V, _AL, _AO, _OM, _IN = 0, 9, 12, 15, 18, 21, 27, 30
# rotation (9), origin (3), joint's motion vector about the world's origin (w 3, v 3), angular
# acceleration (3), acceleration of the origin (3), angular velocity (3), inertia in the world (9)

# Vectors are tuples of three numbers, which the compiler keeps in registers.


@njit(cache=True)
def _vector(values, at):  # type: ignore[no-untyped-def]
    return values[at], values[at + 1], values[at + 2]


@njit(cache=True)
def _put(values, at, a):  # type: ignore[no-untyped-def]
    values[at], values[at + 1], values[at + 2] = a[0], a[1], a[2]


@njit(cache=True)
def _sum(a, b):  # type: ignore[no-untyped-def]
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@njit(cache=True)
def _times(x, a):  # type: ignore[no-untyped-def]
    return x * a[0], x * a[1], x * a[2]


@njit(cache=True)
def _dot(a, b):  # type: ignore[no-untyped-def]
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True)
def _cross(a, b):  # type: ignore[no-untyped-def]
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit(cache=True)
def _matrix(m, at, a):  # type: ignore[no-untyped-def]
    """Product of a matrix by rows and a vector."""
    return _dot(_vector(m, at), a), _dot(_vector(m, at + 3), a), _dot(_vector(m, at + 6), a)


@njit(cache=True)
def _carried(turning, spin, a):  # type: ignore[no-untyped-def]
    """Acceleration of a point of a body that turns, beside that of its origin."""
    return _sum(_cross(turning, a), _cross(spin, _cross(spin, a)))


@njit(cache=True, fastmath=False)
def forward(bodies, q, v, gravity, work):  # type: ignore[no-untyped-def]
    """Poses, velocities and accelerations of the bodies without joint accelerations."""
    turn = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    origin, spin, turning = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    moving = (-gravity[0], -gravity[1], -gravity[2])
    for k in range(q.shape[0]):
        b, s = bodies[k], work[k]
        # the joint's axis in the world: turning about it leaves it where it is
        own = _vector(b, AXIS)
        axis, arm = _matrix(turn, 0, own), _matrix(turn, 0, _vector(b, ORIGIN))
        slide = b[KIND] > 0.5
        if slide:
            arm = _sum(arm, _times(q[k], axis))
        origin = _sum(origin, arm)
        moving = _sum(moving, _carried(turning, spin, arm))
        if slide:
            moving = _sum(moving, _times(2.0 * v[k], _cross(spin, axis)))
            _put(s, _W, (0.0, 0.0, 0.0))
            _put(s, _V, axis)
        else:
            turning = _sum(turning, _times(v[k], _cross(spin, axis)))
            spin = _sum(spin, _times(v[k], axis))
            _put(s, _W, axis)
            _put(s, _V, _cross(origin, axis))
            sn, cs = np.sin(q[k]), np.cos(q[k])
            x, y, z = own
            t = 1.0 - cs
            c0 = _matrix(turn, 0, (cs + t * x * x, t * x * y + sn * z, t * x * z - sn * y))
            c1 = _matrix(turn, 0, (t * x * y - sn * z, cs + t * y * y, t * y * z + sn * x))
            c2 = _matrix(turn, 0, (t * x * z + sn * y, t * y * z - sn * x, cs + t * z * z))
            turn = (c0[0], c1[0], c2[0], c0[1], c1[1], c2[1], c0[2], c1[2], c2[2])
        for d in range(9):
            s[_R + d] = turn[d]
        _put(s, _O, origin)
        _put(s, _AL, turning)
        _put(s, _AO, moving)
        _put(s, _OM, spin)


@njit(cache=True, fastmath=False)
def mass_and_bias(bodies, work, mass, bias):  # type: ignore[no-untyped-def]
    """Mass matrix and bias forces (gravity, Coriolis, centrifugal) after `forward`."""
    m, about = 0.0, np.zeros(9)  # mass and inertia about the world's origin of what is carried
    moment, force, load = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for k in range(bodies.shape[0] - 1, -1, -1):
        b, s = bodies[k], work[k]
        if b[MASS] > 0.0 or b[INERTIA] > 0.0:
            for i in range(3):  # R I R'
                row = _matrix(b, INERTIA, _vector(s, 3 * i))
                _put(s, _IN + 3 * i, _matrix(s, _R, row))
            arm = _matrix(s, _R, _vector(b, COM))
            at = _sum(_vector(s, _O), arm)
            turning, spin = _vector(s, _AL), _vector(s, _OM)
            moving = _sum(_vector(s, _AO), _carried(turning, spin, arm))
            push = _times(b[MASS], moving)
            turned = _sum(_matrix(s, _IN, turning), _cross(spin, _matrix(s, _IN, spin)))
            force = _sum(force, push)
            load = _sum(load, _sum(turned, _cross(at, push)))
            m += b[MASS]
            moment = _sum(moment, _times(b[MASS], at))
            square = _dot(at, at)
            for i in range(3):
                for j in range(3):
                    about[3 * i + j] += s[_IN + 3 * i + j] - b[MASS] * at[i] * at[j]
                about[4 * i] += b[MASS] * square
        w, v = _vector(s, _W), _vector(s, _V)
        bias[k] = _dot(w, load) + _dot(v, force)
        linear = _sum(_times(m, v), _cross(w, moment))
        angular = _sum(_matrix(about, 0, w), _cross(moment, v))
        for j in range(k + 1):
            t = work[j]
            e = _dot(_vector(t, _W), angular) + _dot(_vector(t, _V), linear)
            mass[k, j] = e
            mass[j, k] = e
        mass[k, k] += b[ARMATURE]


@njit(cache=True, fastmath=False)
def solve(mass, force, out):  # type: ignore[no-untyped-def]
    """Solve mass @ out = force by Cholesky; the lower half of `mass` is overwritten."""
    n = force.shape[0]
    for i in range(n):
        for j in range(i + 1):
            e = mass[i, j]
            for k in range(j):
                e -= mass[i, k] * mass[j, k]
            if i == j:
                mass[i, i] = np.sqrt(e)
            else:
                mass[i, j] = e / mass[j, j]
    for i in range(n):
        e = force[i]
        for k in range(i):
            e -= mass[i, k] * out[k]
        out[i] = e / mass[i, i]
    for i in range(n - 1, -1, -1):
        e = out[i]
        for k in range(i + 1, n):
            e -= mass[k, i] * out[k]
        out[i] = e / mass[i, i]


@njit(cache=True, fastmath=False)
def _add_push(work, count, at, push, force):  # type: ignore[no-untyped-def]
    """Add the joint forces of a push at a point of the world to `force`."""
    moment = _cross(at, push)
    for k in range(count):
        force[k] += _dot(_vector(work[k], _W), moment) + _dot(_vector(work[k], _V), push)


@njit(cache=True, fastmath=False)
def add_tool_force(work, tool, local, force):  # type: ignore[no-untyped-def]
    """Add the joint forces of a force at the tool, given in the tool's frame, to `force`."""
    s = work[work.shape[0] - 1]
    at = _sum(_vector(s, _O), _matrix(s, _R, tool))
    _add_push(work, work.shape[0], at, _matrix(s, _R, local), force)


@njit(cache=True, fastmath=False)
def add_weight(bodies, work, body, share, gravity, force):  # type: ignore[no-untyped-def]
    """Add the joint forces of a share of a body's weight, at its centre of mass, to `force`."""
    s, b = work[body], bodies[body]
    at = _sum(_vector(s, _O), _matrix(s, _R, _vector(b, COM)))
    _add_push(work, body + 1, at, _times(share * b[MASS], gravity), force)


@njit(cache=True, fastmath=False)
def tool_acceleration(work, tool, acceleration, out):  # type: ignore[no-untyped-def]
    """Proper acceleration of the tool in the last link's frame, after `forward`."""
    n = work.shape[0]
    s = work[n - 1]
    arm = _matrix(s, _R, tool)
    at = _sum(_vector(s, _O), arm)
    whole = _sum(_vector(s, _AO), _carried(_vector(s, _AL), _vector(s, _OM), arm))
    for k in range(n):
        t = work[k]
        moved = _sum(_vector(t, _V), _cross(_vector(t, _W), at))
        whole = _sum(whole, _times(acceleration[k], moved))
    for d in range(3):
        out[d] = s[d] * whole[0] + s[3 + d] * whole[1] + s[6 + d] * whole[2]


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
    cable: Array = dataclasses.field(default_factory=lambda: np.zeros(7))
    """A coupling of two joints: their degrees of freedom, ratio, stiffness, rest of a spring,
    friction and rotor inertia of a motor that turns with both; shape (7,)."""
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
class Signals:
    """What happened at every sample (or at every step inside a sample), or what was read."""

    position: Array
    """What perfect encoders say, of shape (T, n) [rad or m]."""
    velocity: Array
    """Velocities at the motors, of shape (T, n)."""
    acceleration: Array
    """Proper acceleration of the tool in its frame, of shape (T, 3) [m/s²]."""
    torque: Array
    """Torques that the drives ask for, of shape (T, n) [N m or N]."""
    joint_acceleration: Array
    """Accelerations of the joints, of shape (T, n); never recorded."""


class _Arrays(NamedTuple):
    """The arrays of a `System`, as compiled code takes them."""

    bodies: Array
    laws: Array
    drives: Array
    gravity: Array
    tool: Array
    cable: Array
    fan: Array


class _Room(NamedTuple):
    """Working space, and what `_derivative` leaves beside the derivative."""

    work: Array
    mass: Array
    force: Array
    torque: Array
    held: Array


@njit(cache=True, fastmath=False)
def _derivative(arm, room, powered, sampled, command, time, y, dy):  # type: ignore[no-untyped-def]
    """Derivative of the state: positions, velocities, memories of laws, lagging commands."""
    laws, drives, cable, fan = arm.laws, arm.drives, arm.cable, arm.fan
    mass, force, torque = room.mass, room.force, room.torque
    n, m = arm.bodies.shape[0], drives.shape[0]
    q, v, z, lag = y[:n], y[n : 2 * n], y[2 * n : 3 * n], y[3 * n :]
    forward(arm.bodies, q, v, arm.gravity, room.work)
    mass_and_bias(arm.bodies, room.work, mass, force)
    bias = force.copy()
    dy[:n] = v
    for k in range(n):
        force[k] = joint_force(laws[k], q[k], v[k], z[k], time) - force[k]
        dy[2 * n + k] = 0.0
        if laws[k, SLACK_FORCE] != 0.0:
            beyond = abs(q[k] - z[k]) - 0.5 * laws[k, SLACK] - laws[k, ELASTIC]
            if beyond > 0.0:  # it slides, and what a step went too far is made good
                side = np.sign(q[k] - z[k])
                dy[2 * n + k] = side * (max(side * v[k], 0.0) + beyond / 0.01)
    load = 0.0
    for j in range(m):
        row, k = drives[j], int(drives[j, 0])
        late = row[LAG] > 0.0 or row[SPEED_LIMIT] > 0.0
        dy[3 * n + j] = 0.0
        if late:
            dy[3 * n + j] = (command[j] - lag[j]) / (row[LAG] if row[LAG] > 0.0 else 2e-3)
        if row[SPEED_LIMIT] > 0.0:
            dy[3 * n + j] = min(max(dy[3 * n + j], -row[SPEED_LIMIT]), row[SPEED_LIMIT])
        torque[j] = 0.0
        if sampled:
            torque[j] = room.held[j]
        elif powered:
            torque[j] = drive_torque(row, lag[j] if late else command[j], q[k], v[k])
        load += abs(torque[j]) / row[LIMIT]
    for j in range(m):
        k = int(drives[j, 0])
        given = torque[j] * drives[j, GAIN] / (1.0 + drives[j, SAG] * load)
        force[k] += given
        if drives[j, LOADED] > 0.0:
            force[k] += gear_friction(drives[j], given, bias[k], v[k])
    for k in range(n):
        if arm.bodies[k, CARRIED] != 0.0:
            add_weight(arm.bodies, room.work, k, -arm.bodies[k, CARRIED], arm.gravity, force)
    if cable[3] != 0.0 or cable[5] != 0.0:
        # a spring over two joints, and a motor that turns with both: its friction and its rotor
        i, j, ratio = int(cable[0]), int(cable[1]), cable[2]
        pull = cable[3] * (q[i] + ratio * q[j] - cable[4])
        pull += cable[5] * np.tanh((v[i] + ratio * v[j]) / 5e-3)
        force[i] -= pull
        force[j] -= ratio * pull
        mass[i, i] += cable[6]
        mass[j, j] += ratio * ratio * cable[6]
        mass[i, j] += ratio * cable[6]
        mass[j, i] += ratio * cable[6]
    if fan[3] > 0.0:
        swing = np.sin(2.0 * np.pi * fan[3] * time + fan[4])
        add_tool_force(room.work, arm.tool, fan[:3] * swing, force)
    solve(mass, force, dy[n : 2 * n])


@njit(cache=True, fastmath=False)
def _command(commands, straight, x, width):  # type: ignore[no-untyped-def]
    """Commands at x samples each, on a straight line or held; the mean over a width where held."""
    out = np.empty(commands.shape[1])
    last = commands.shape[0] - 1
    for j in range(len(out)):
        at = min(max(x[j], 0.0), 1.0 * last)
        first = min(int(at + 1e-9), last)
        step = commands[min(first + 1, last), j] - commands[first, j]
        share = at - first
        if not straight:
            share = min(max(1.0 + (at - first - 1.0) / width, 0.0), 1.0) if width > 0.0 else 0.0
        out[j] = commands[first, j] + (share if abs(share) > 1e-6 else 0.0) * step
    return out


@njit(cache=True, fastmath=False)
def _run(  # type: ignore[no-untyped-def]
    arm, release, commands, q, v, settle, inside, every, straight, servo, sample
):
    drives, samples = arm.drives, commands.shape[0]
    dofs, n = q.shape[0], drives.shape[0]
    step, rows = sample / inside, samples * inside // every
    out = np.zeros((rows, 4 * n + 3))
    room = _Room(
        np.zeros((dofs, WORK)), np.zeros((dofs, dofs)), np.zeros(dofs), np.zeros(n), np.zeros(n)
    )
    z = np.where(arm.laws[:, SLACK_FORCE] != 0.0, q, 0.0)
    y = np.concatenate((q, v, z, commands[0]))
    slopes = np.zeros((4, len(y)))
    acceleration = np.zeros(3)
    period, delay = int(servo[0]), int(servo[1])
    sampled = period > 0
    waiting, before, estimate = np.zeros((8, n)), np.zeros(n), np.zeros(n)
    row = 0
    for i in range(-settle * inside, samples * inside):
        time, on = i * step, i < release * inside
        x = (time - drives[:, DELAY]) / sample
        there = _command(commands, straight, x, 0.0)
        command = _command(commands, straight, x, 1.0 / inside)
        if sampled and i % period == 0:
            turn, first = (i // period) % 8, i == -settle * inside
            for j in range(n):
                measured = y[int(drives[j, 0])]
                if servo[3] > 0.0:
                    measured = np.round(measured / servo[3]) * servo[3]
                if not first:
                    speed = (measured - before[j]) / (period * step)
                    estimate[j] += servo[2] * (speed - estimate[j])
                before[j] = measured
                late = drives[j, LAG] > 0.0 or drives[j, SPEED_LIMIT] > 0.0
                target = y[3 * dofs + j] if late else there[j]
                waiting[turn, j] = drive_torque(drives[j], target, measured, estimate[j])
                if first:
                    waiting[:, j] = waiting[turn, j]
                room.held[j] = waiting[(turn - delay) % 8, j]
        if i >= 0 and i % every == 0 and row < rows:
            # sensors read what is there at their moment, not what comes within the step
            _derivative(arm, room, on, sampled, there, time, y, slopes[0])
            a = slopes[0, dofs : 2 * dofs]
            tool_acceleration(room.work, arm.tool, a, acceleration)
            for j in range(n):
                k, soft = int(drives[j, 0]), int(drives[j, LINK_SIDE])
                error, slope = encoder(drives[j], y[k])
                out[row, j] = y[k] + error + (y[soft] if soft >= 0 else 0.0)
                out[row, n + j] = y[dofs + k] * (1.0 + slope)
                out[row, 3 * n + 3 + j] = a[k]
                if soft >= 0:
                    out[row, n + j] += y[dofs + soft]
                    out[row, 3 * n + 3 + j] += a[soft]
                asked = waiting[(i // period) % 8, j] if sampled else room.torque[j]
                out[row, 2 * n + 3 + j] = asked
            out[row, 2 * n : 2 * n + 3] = acceleration
            row += 1
        for stage in range(4):
            part = 0.0 if stage == 0 else step if stage == 3 else 0.5 * step
            trial = y + part * slopes[max(stage - 1, 0)]
            if straight:
                command = _command(commands, straight, x + part / sample, 0.0)
            _derivative(
                arm, room, on, sampled, command, time + part, trial, slopes[stage]
            )  # fmt: skip
        y += step / 6.0 * (slopes[0] + 2.0 * slopes[1] + 2.0 * slopes[2] + slopes[3])
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
    servo: tuple[int, int, float, float] = (0, 0, 1.0, 0.0),
    sample: float = SAMPLE,
) -> Signals:
    """Run an arm through a list of commands, one every `sample`.

    ``servo`` samples the drives: steps between samples (0: continuous), samples of delay (at most
    7), share of a new velocity in the filtered one, step of the encoders [rad].
    """
    n = system.drives.shape[0]
    q = np.zeros(len(system.bodies))
    q[system.joint_dofs] = commands[0] - system.drives[:, OFFSET]
    v = np.zeros_like(q)
    if start is not None:
        q, v = start
    arm = _Arrays(*(getattr(system, name) for name in _Arrays._fields))
    out = _run(
        arm, len(commands) if release is None else release, np.ascontiguousarray(commands), q, v,
        round(settle / sample), inside, 1 if fine else inside, straight,
        np.array(servo, dtype=float), sample,
    )  # fmt: skip
    position, velocity, acceleration, torque, joint_acceleration = np.split(
        out, [n, 2 * n, 2 * n + 3, 3 * n + 3], axis=1
    )
    return Signals(
        position=position, velocity=velocity, acceleration=acceleration, torque=torque,
        joint_acceleration=joint_acceleration,
    )  # fmt: skip


@dataclasses.dataclass(frozen=True, kw_only=True)
class Factors:
    """What a true arm is beside its nominal figures, each of shape (n,); a model has tolerances."""

    mass: Array
    inertia: Array
    armature: Array
    damping: Array
    kp: Array
    kv: Array
    """True over nominal figure, of these."""
    x: Array | float = 0.0
    y: Array | float = 0.0
    z: Array | float = 0.0
    """Shift of the centre of mass, over the length of the link."""
    zero: Array | float = 0.0
    """Error of the encoders' zero [rad or m]."""
    shift: Array | float = 0.0
    """Time by which commands act late, or if negative early [s]."""
    constant: Array | float = 1.0
    """Measured over true torque."""
    offset: Array | float = 0.0
    """Offset of the measured torque over the drive's limit."""

    @classmethod
    def ones(cls, joints: int) -> Factors:
        """An arm that is exactly the nominal one."""
        return cls(**{name: np.ones(joints) for name in FACTORS})

    @classmethod
    def draw(cls, joints: int, rng: np.random.Generator) -> Factors:
        """Errors of 1 to 3 % and of random sign of all but centres, zeros and times."""
        return cls(
            **{
                name: 1 + rng.uniform(0.01, 0.03, joints) * rng.choice([-1, 1], joints)
                for name in FACTORS
            }
        )

    def changed(self, name: str, joint: int, by: float) -> Factors:
        """The same factors with one of them moved by `by`."""
        values = np.array(np.broadcast_to(getattr(self, name), self.mass.shape), dtype=float)
        values[joint] += by
        return dataclasses.replace(self, **{name: values})


FACTORS = ("mass", "inertia", "armature", "damping", "kp", "kv")
"""Names of the factors that are ratios of figures of the model."""


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
    n = figures.joints
    centre = np.array([np.broadcast_to(getattr(factors, axis), n) for axis in "xyz"]).T
    zero, shift = np.broadcast_to(factors.zero, n), np.broadcast_to(factors.shift, n)
    for i, link in enumerate(figures.links):
        bodies.append(
            body_row(
                link.kind, link.axis, link.offset, link.mass * factors.mass[i],
                np.array(link.com) + centre[i] * link.length,
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
        drive[OFFSET], drive[DELAY], drive[LINK_SIDE] = zero[i], shift[i], -1.0
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
    system.drives[system.drives[:, LINK_SIDE] >= at, LINK_SIDE] += 1
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


def free_base(system: System, axis: Array, kind: str = "hinge") -> int:
    """Set the whole arm on a hinge through the world's origin, or on a slide."""
    base = body_row(kind, axis, np.zeros(3), 0.0, np.zeros(3), np.zeros((3, 3)), 0.0)
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
    thick, turn = along @ inertia @ along, np.outer(along, along)
    bar = near * length**2 / 12 * (np.eye(3) - turn) + share * thick * turn
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


def at_rest(system: System, joints: Array) -> tuple[Array, Array, Array]:
    """Mass matrix (N, N), gravity's load (N,) and working space, extra joints at zero."""
    dofs = len(system.bodies)
    q = np.zeros(dofs)
    q[system.joint_dofs] = joints
    work = np.zeros((dofs, WORK))
    mass, bias = np.zeros((dofs, dofs)), np.zeros(dofs)
    forward(system.bodies, q, np.zeros(dofs), system.gravity, work)
    mass_and_bias(system.bodies, work, mass, bias)
    return mass, bias, work


def mass_matrix(system: System, joints: Array) -> Array:
    """Mass matrix with the joints at given positions and the extra ones at rest, (N, N)."""
    return at_rest(system, joints)[0]


def felt_inertia(system: System, dof: int, joints: Array) -> float:
    """Inertia that a force in one degree of freedom feels, all others free."""
    return 1.0 / float(np.linalg.inv(mass_matrix(system, joints))[dof, dof])
