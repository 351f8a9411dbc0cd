"""True arm as arrays: built, altered by extra joints and masses, and integrated in time."""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from loose_env.typing import Array
from scripts.suites.gap.arms import GRAVITY, Machine


def _record(names: str) -> np.dtype[np.void]:
    return np.dtype([(name, float) for name in names.split()])


# Viscous coefficient, a further one and the speed at which it has thinned by a tenth; drag by the
# square of speed; Coulomb torque, static over Coulomb torque minus one, Stribeck speed, width of
# the tangent, time in which the friction warms away (0: never), excess in the positive direction
# over the mean of both, waves a turn by which it varies from none to twice its mean (0: not) and
# their phase; spring, its rest, and one over the square of the stretch that doubles its stiffness
# / 3; half of a free travel, stiffness of its stops (force / travel^1.5), their dissipation;
# ripple's amplitude, periods per unit of travel times 2 pi, phase, share of the second harmonic;
# dry friction of an element that is coupled with slack and an elastic way.
LAW = _record("""
    damping extra thinning drag
    friction bump stribeck_speed smooth_speed warm_time asymmetry waves wave_phase
    stiffness rest progress  travel hertz crossley
    ripple order phase second  slack_force slack elastic
""")
"""Laws of one degree of freedom."""

# Driven degree of freedom, gains, largest torque, torque over commanded torque, time constant and
# delay of the command, its largest speed (0: any); error of the encoder, of which a part is
# periodic in the turn of the joint, and the extra degree of freedom that an encoder on the link's
# side reads too (-1 on the motor's); dead zone of the position error, fall of the gain with the
# load of all drives, and the part of kv that is back-EMF, which acts beyond the limit of the
# torque; friction of the gear over the torque of the drive, static over that minus one, Stribeck
# speed, width of the tangent, friction of what is behind the gear over the torque of the load.
DRIVE = _record("""
    dof kp kv limit gain lag delay speed_limit
    offset sine cosine link_side  dead sag back_emf
    loaded loaded_bump loaded_speed loaded_smooth loaded_external
""")
"""Numbers of one drive."""

KIND, AXIS, ORIGIN, MASS, COM, INERTIA, ARMATURE, CARRIED = 0, 1, 4, 7, 8, 11, 20, 21
"""First columns of a body: kind (0 hinge, 1 slide), axis (3), offset (3), mass, centre of mass
(3), inertia matrix by rows (9), rotor inertia, share of its weight that something else carries."""
BODY = 22
WORK = 36  # length of a body's row of working space
_R, _O, _W, _V, _AL, _AO, _OM, _IN = 0, 9, 12, 15, 18, 21, 24, 27
# rotation (9), origin (3), joint's motion vector about the world's origin (w 3, v 3), angular
# acceleration (3), acceleration of the origin (3), angular velocity (3), inertia in the world (9)


@njit(cache=True)
def _joint_force(law, q, v, z, time):  # type: ignore[no-untyped-def]
    """Passive force of one degree of freedom."""
    viscous = law.damping * v
    if law.extra != 0.0:
        viscous += law.extra * v / (1.0 + abs(v) / law.thinning) ** 0.152
    force = -viscous - law.drag * v * abs(v)
    if law.friction != 0.0:
        bump, fade = 0.0, 1.0
        if law.bump != 0.0:
            x = v / law.stribeck_speed
            bump = law.bump * np.exp(-x * x)
        if law.warm_time > 0.0 and time > 0.0:
            fade = np.exp(-time / law.warm_time)
        side = 1.0 + law.asymmetry if v > 0.0 else 1.0 - law.asymmetry
        if law.waves != 0.0:
            fade *= 1.0 + np.cos(law.waves * q + law.wave_phase)
        force -= law.friction * fade * side * (1.0 + bump) * np.tanh(v / law.smooth_speed)
    if law.stiffness != 0.0:
        x = q - law.rest
        force -= law.stiffness * x * (1.0 + law.progress * x * x)
    if law.hertz > 0.0 and abs(q) > law.travel:
        depth, side = abs(q) - law.travel, np.sign(q)
        push = law.hertz * depth * np.sqrt(depth) * (1.0 + law.crossley * side * v)
        force -= side * max(push, 0.0)
    if law.ripple != 0.0:
        x = law.order * q + law.phase
        force += law.ripple * (np.sin(x) + law.second * np.sin(2.0 * x + 0.7))
    if law.slack_force != 0.0:
        stretch = abs(q - z) - 0.5 * law.slack
        force -= law.slack_force * np.sign(q - z) * min(max(stretch / law.elastic, 0.0), 1.0)
    return force


@njit(cache=True)
def _encoder(drive, q):  # type: ignore[no-untyped-def]
    """Error of an encoder and its derivative by the angle, of a wheel that turns off its centre."""
    error = drive.offset + drive.sine * np.sin(q) + drive.cosine * np.cos(q)
    return error, drive.sine * np.cos(q) - drive.cosine * np.sin(q)


@njit(cache=True)
def _drive_torque(drive, command, q, v):  # type: ignore[no-untyped-def]
    """Torque that a drive asks for: position servo with a dead zone, and the limit of its motor."""
    error, slope = _encoder(drive, q)
    error = command - q - error
    if drive.dead > 0.0:
        error = np.sign(error) * max(abs(error) - drive.dead, 0.0)
    torque = drive.kp * error - (drive.kv - drive.back_emf) * v * (1.0 + slope)
    return min(max(torque, -drive.limit), drive.limit) - drive.back_emf * v


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


@njit(cache=True)
def _rigid(bodies, q, v, gravity, work, mass, bias):  # type: ignore[no-untyped-def]
    """Mass matrix and bias forces (gravity, Coriolis, centrifugal); motion of the bodies in `work`.

    First the bodies' poses, velocities and accelerations without joint accelerations, from the
    base; then, from the tip, mass, moment and inertia of all that each joint carries.
    """
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
    m, about = 0.0, np.zeros(9)  # mass and inertia about the world's origin of what is carried
    moment, force, load = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for k in range(q.shape[0] - 1, -1, -1):
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
        w, v1 = _vector(s, _W), _vector(s, _V)
        bias[k] = _dot(w, load) + _dot(v1, force)
        linear = _sum(_times(m, v1), _cross(w, moment))
        angular = _sum(_matrix(about, 0, w), _cross(moment, v1))
        for j in range(k + 1):
            t1 = work[j]
            mass[k, j] = _dot(_vector(t1, _W), angular) + _dot(_vector(t1, _V), linear)
            mass[j, k] = mass[k, j]
        mass[k, k] += b[ARMATURE]


@njit(cache=True)
def _solve(mass, force, out):  # type: ignore[no-untyped-def]
    """Solve mass @ out = force by Cholesky; the lower half of `mass` is overwritten."""
    n = force.shape[0]
    for i in range(n):
        for j in range(i + 1):
            e = mass[i, j]
            for k in range(j):
                e -= mass[i, k] * mass[j, k]
            mass[i, j] = np.sqrt(e) if i == j else e / mass[j, j]
    for i in range(n):
        out[i] = force[i]
        for k in range(i):
            out[i] -= mass[i, k] * out[k]
        out[i] /= mass[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            out[i] -= mass[k, i] * out[k]
        out[i] /= mass[i, i]


@njit(cache=True)
def _push(work, body, place, push, force):  # type: ignore[no-untyped-def]
    """Add the joint forces of a push in the world at a place of a body to `force`."""
    at = _sum(_vector(work[body], _O), _matrix(work[body], _R, place))
    moment = _cross(at, push)
    for k in range(body + 1):
        force[k] += _dot(_vector(work[k], _W), moment) + _dot(_vector(work[k], _V), push)


@njit(cache=True)
def _tool_acceleration(work, tool, acceleration):  # type: ignore[no-untyped-def]
    """Proper acceleration of the tool in the last link's frame, after `_rigid`."""
    s = work[work.shape[0] - 1]
    arm = _matrix(s, _R, tool)
    at = _sum(_vector(s, _O), arm)
    a = _sum(_vector(s, _AO), _carried(_vector(s, _AL), _vector(s, _OM), arm))
    for k in range(work.shape[0]):
        moved = _sum(_vector(work[k], _V), _cross(_vector(work[k], _W), at))
        a = _sum(a, _times(acceleration[k], moved))
    return (
        s[0] * a[0] + s[3] * a[1] + s[6] * a[2],
        s[1] * a[0] + s[4] * a[1] + s[7] * a[2],
        s[2] * a[0] + s[5] * a[1] + s[8] * a[2],
    )


@njit(cache=True)
def _derivative(arm, room, powered, command, time, y, dy):  # type: ignore[no-untyped-def]
    """Derivative of the state: positions, velocities, memories of laws, lagging commands.

    `room` is working space; of a drive that is sampled it has the torque that it holds, else what
    the drives ask for is left in it.
    """
    bodies, laws, drives, gravity, tool, cable, fan = arm
    work, mass, force, torque, sampled = room
    n, m = bodies.shape[0], drives.shape[0]
    q, v, z, lag = y[:n], y[n : 2 * n], y[2 * n : 3 * n], y[3 * n :]
    _rigid(bodies, q, v, gravity, work, mass, force)
    bias = force.copy()
    dy[:n] = v
    for k in range(n):
        law = laws[k]
        force[k] = _joint_force(law, q[k], v[k], z[k], time) - force[k]
        dy[2 * n + k] = 0.0
        if law.slack_force != 0.0:
            beyond = abs(q[k] - z[k]) - 0.5 * law.slack - law.elastic
            if beyond > 0.0:  # it slides, and what a step went too far is made good
                side = np.sign(q[k] - z[k])
                dy[2 * n + k] = side * (max(side * v[k], 0.0) + beyond / 0.01)
    load = 0.0
    for j in range(m):
        drive, k, target = drives[j], int(drives[j].dof), command[j]
        dy[3 * n + j] = 0.0
        if drive.lag > 0.0 or drive.speed_limit > 0.0:
            rate = (target - lag[j]) / (drive.lag if drive.lag > 0.0 else 2e-3)
            if drive.speed_limit > 0.0:
                rate = min(max(rate, -drive.speed_limit), drive.speed_limit)
            dy[3 * n + j], target = rate, lag[j]
        if not sampled:
            torque[j] = _drive_torque(drive, target, q[k], v[k]) if powered else 0.0
        load += abs(torque[j]) / drive.limit
    for j in range(m):
        drive, k = drives[j], int(drives[j].dof)
        given = torque[j] * drive.gain / (1.0 + drive.sag * load)
        force[k] += given
        if drive.loaded > 0.0:  # friction of teeth under the torques of a drive and of its load
            x = v[k] / drive.loaded_speed
            size = drive.loaded * abs(given) * (1.0 + drive.loaded_bump * np.exp(-x * x))
            size += drive.loaded_external * abs(bias[k])
            force[k] -= size * np.tanh(v[k] / drive.loaded_smooth)
    for k in range(n):
        if bodies[k, CARRIED] != 0.0:
            weight = _times(-bodies[k, CARRIED] * bodies[k, MASS], gravity)
            _push(work, k, _vector(bodies[k], COM), weight, force)
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
        local = _times(np.sin(2.0 * np.pi * fan[3] * time + fan[4]), fan)
        _push(work, n - 1, tool, _matrix(work[n - 1], _R, local), force)
    _solve(mass, force, dy[n : 2 * n])


@njit(cache=True)
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


@njit(cache=True)
def _run(arm, release, commands, q, settle, inside, every, straight, servo, sample):  # type: ignore[no-untyped-def]
    bodies, laws, drives, _, tool, _, _ = arm
    dofs, n = bodies.shape[0], drives.shape[0]
    step, steps = sample / inside, commands.shape[0] * inside
    out = np.zeros((steps // every, 4 * n + 3))
    period, late, smoothing = int(servo[0]), servo[1] > 0.0, servo[2]
    work, mass, force = np.zeros((dofs, WORK)), np.zeros((dofs, dofs)), np.zeros(dofs)
    torque, sampled = np.zeros(n), period > 0
    room = (work, mass, force, torque, sampled)
    asked, before, estimate = np.zeros(n), np.zeros(n), np.zeros(n)
    y = np.concatenate((q, np.zeros(dofs), np.where(laws.slack_force != 0.0, q, 0.0), commands[0]))
    slopes = np.zeros((4, len(y)))
    for i in range(-settle * inside, steps):
        time, on = i * step, i < release * inside
        x = (time - drives.delay) / sample
        there = _command(commands, straight, x, 0.0)
        command = _command(commands, straight, x, 1.0 / inside)
        if sampled and i % period == 0:
            first = i == -settle * inside
            for j in range(n):
                drive = drives[j]
                measured = y[int(drive.dof)]
                if not first:
                    speed = (measured - before[j]) / (period * step)
                    estimate[j] += smoothing * (speed - estimate[j])
                before[j] = measured
                lagging = drive.lag > 0.0 or drive.speed_limit > 0.0
                target = y[3 * dofs + j] if lagging else there[j]
                now = _drive_torque(drive, target, measured, estimate[j])
                torque[j] = asked[j] if late and not first else now
                asked[j] = now
        if i >= 0 and i % every == 0:
            # sensors read what is there at their moment, not what comes within the step
            row = out[i // every]
            _derivative(arm, room, on, there, time, y, slopes[0])
            a = slopes[0, dofs : 2 * dofs]
            for j in range(n):
                k, soft = int(drives[j].dof), int(drives[j].link_side)
                error, slope = _encoder(drives[j], y[k])
                row[j] = y[k] + error + (y[soft] if soft >= 0 else 0.0)
                row[n + j] = y[dofs + k] * (1.0 + slope)
                row[3 * n + 3 + j] = a[k]
                if soft >= 0:
                    row[n + j] += y[dofs + soft]
                    row[3 * n + 3 + j] += a[soft]
                row[2 * n + 3 + j] = asked[j] if sampled else torque[j]
            _put(row, 2 * n, _tool_acceleration(work, tool, a))
        for stage in range(4):
            part = 0.0 if stage == 0 else step if stage == 3 else 0.5 * step
            trial = y + part * slopes[max(stage - 1, 0)]
            if straight:
                command = _command(commands, straight, x + part / sample, 0.0)
            _derivative(arm, room, on, command, time + part, trial, slopes[stage])
        y += step / 6.0 * (slopes[0] + 2.0 * slopes[1] + 2.0 * slopes[2] + slopes[3])
    return out


@njit(cache=True)
def needed(bodies, damping, gravity, q, v, a):  # type: ignore[no-untyped-def]
    """Torques that bodies need for a motion, of shape (T, n)."""
    samples, n = q.shape
    out, work = np.zeros((samples, n)), np.zeros((n, WORK))
    mass, bias = np.zeros((n, n)), np.zeros(n)
    for i in range(samples):
        _rigid(bodies, q[i], v[i], gravity, work, mass, bias)
        for j in range(n):
            out[i, j] = bias[j] + damping[j] * v[i, j]
            for k in range(n):
                out[i, j] += mass[j, k] * a[i, k]
    return out


class Signals(NamedTuple):
    """What happened at every sample (or at every step inside a sample), or what was read."""

    position: Array  # What perfect encoders say, of shape (T, n) [rad or m]
    velocity: Array  # Velocities at the motors, of shape (T, n)
    acceleration: Array  # Proper acceleration of the tool in its frame, of shape (T, 3) [m/s²]
    torque: Array  # Torques that the drives ask for, of shape (T, n) [N m or N]
    joint_acceleration: Array  # Accelerations of the joints, of shape (T, n); never recorded


@dataclasses.dataclass(kw_only=True)
class System:
    """A true arm in arrays: n drives, N >= n degrees of freedom."""

    bodies: Array  # Figures of the bodies, of shape (N, BODY)
    laws: NDArray[np.void]  # Laws in the degrees of freedom, (N,) of `LAW`
    drives: NDArray[np.void]  # Drives in the order of the joints, (n,) of `DRIVE`
    gravity: Array  # Acceleration of free fall in the world, of shape (3,) [m/s²]
    tool: Array  # The tool in the last body's frame, of shape (3,) [m]
    cable: Array
    """A coupling of two joints: their degrees of freedom, ratio, stiffness, rest of a spring,
    friction and rotor inertia of a motor that turns with both; shape (7,)."""
    fan: Array
    """A force at the tool in its frame (3) [N], its frequency [Hz] and phase [rad]; shape (5,)."""
    proximal: NDArray[np.int64]
    """Body that carries the proximal end of each link, of shape (n,)."""
    torque_gain: Array  # Measured over true torque, of shape (n,)
    torque_offset: Array  # Constant of the measured torque, of shape (n,) [N m or N]
    rotation: Array = dataclasses.field(default_factory=lambda: np.eye(3))
    """Reading of the accelerometer = rotation @ truth, of shape (3, 3)."""
    sensors: dict[str, dict[str, Any]] = dataclasses.field(
        default_factory=lambda: {"gain": {}, "bias": {}, "delay": {}, "step": {}}
    )
    """Factor, constant, delay [s], and step to which it is rounded, noise and all, by sensor."""
    straight: bool = False
    """Whether commands are in straight lines that the model takes as held."""

    @classmethod
    def build(cls, machine: Machine, factors: Factors) -> System:
        """The arm without any missing effect."""
        n = machine.joints
        bodies, laws, drives = np.zeros((n, BODY)), np.zeros(n, LAW), np.zeros(n, DRIVE)
        bodies[:, KIND], bodies[:, MASS] = machine.slide, machine.mass * factors["mass"]
        bodies[:, AXIS : AXIS + 3], bodies[:, ORIGIN : ORIGIN + 3] = machine.axis, machine.offset
        centre = np.stack([factors[axis] for axis in "xyz"], axis=1)
        bodies[:, COM : COM + 3] = machine.com + centre * machine.length[:, None]
        bodies[:, INERTIA : INERTIA + 9 : 4] = machine.inertia * factors["inertia"][:, None]
        bodies[:, ARMATURE] = machine.armature * factors["armature"]
        laws["damping"] = machine.damping * factors["damping"]
        drives["dof"], drives["link_side"] = np.arange(n), -1
        drives["kp"], drives["kv"] = machine.kp * factors["kp"], machine.kv * factors["kv"]
        drives["limit"], drives["gain"] = machine.limit, 1.0
        drives["offset"], drives["delay"] = factors["zero"], factors["shift"]
        return cls(
            bodies=bodies, laws=laws, drives=drives, gravity=np.array([0.0, 0.0, -GRAVITY]),
            tool=machine.end[-1].copy(), cable=np.zeros(7), fan=np.zeros(5), proximal=np.arange(n),
            torque_gain=factors["constant"].copy(), torque_offset=factors["offset"] * machine.limit,
        )  # fmt: skip

    @property
    def joint_dofs(self) -> NDArray[np.int64]:
        """Degree of freedom on the motor's side of each joint, of shape (n,)."""
        return self.drives["dof"].astype(np.int64)

    @property
    def slides(self) -> NDArray[np.bool_]:
        """Degrees of freedom that slide, of shape (N,)."""
        return self.bodies[:, KIND] > 0.5

    def simulate(
        self,
        commands: Array,
        *,
        sample: float,
        inside: int,
        settle: float,
        release: int | None = None,
        fine: bool = False,
        straight: bool = False,
        servo: tuple[int, float, float] = (0, 0.0, 1.0),
    ) -> Signals:
        """Run through a list of commands, one every `sample`, after the first one was held.

        ``servo`` samples the drives: steps between samples (0: continuous), whether they are a
        sample late (1), share of a new velocity in the filtered one.
        """
        n = len(self.drives)
        q = np.zeros(len(self.bodies))
        q[self.joint_dofs] = commands[0] - self.drives["offset"]
        arm = (self.bodies, self.laws, self.drives, self.gravity, self.tool, self.cable, self.fan)
        out = _run(
            arm, len(commands) if release is None else release, np.ascontiguousarray(commands), q,
            round(settle / sample), inside, 1 if fine else inside, straight,
            np.array(servo, dtype=float), sample,
        )  # fmt: skip
        return Signals(*np.split(out, [n, 2 * n, 2 * n + 3, 3 * n + 3], axis=1))

    def at_rest(self, joints: Array) -> tuple[Array, Array]:
        """Mass matrix (N, N) and gravity's load (N,), extra joints at zero."""
        dofs = len(self.bodies)
        q, mass, bias = np.zeros(dofs), np.zeros((dofs, dofs)), np.zeros(dofs)
        q[self.joint_dofs] = joints
        work = np.zeros((dofs, WORK))
        _rigid(self.bodies, q, np.zeros(dofs), self.gravity, work, mass, bias)
        return mass, bias

    def felt_inertia(self, dof: int, joints: Array) -> float:
        """Inertia that a force in one degree of freedom feels, all others free."""
        return 1.0 / float(np.linalg.inv(self.at_rest(joints)[0])[dof, dof])

    def _insert(self, at: int, body: Array) -> int:
        """Put a body in front of position `at`; every index to the rows behind moves on."""
        self.bodies = np.insert(self.bodies, at, body, axis=0)
        self.laws = np.insert(self.laws, at, np.zeros((), LAW))
        self.drives["dof"][self.drives["dof"] >= at] += 1
        self.cable[:2][self.cable[:2] >= at] += 1
        self.proximal[self.proximal >= at] += 1
        return at

    def free_link(self, link: int, kind: str, axis: Array) -> int:
        """Set a link on an extra joint between it and the motor of its joint."""
        at = int(self.proximal[link])
        carried = self.bodies[at].copy()
        carried[KIND] = float(kind == "slide")
        carried[AXIS:ORIGIN], carried[ORIGIN:MASS], carried[ARMATURE] = axis, 0.0, 0.0
        self.bodies[at, MASS:ARMATURE] = 0.0
        self.proximal[link] = self._insert(at + 1, carried)
        return at + 1

    def free_base(self, axis: Array) -> int:
        """Set the whole arm on a hinge through the world's origin."""
        base = np.zeros(BODY)
        base[AXIS:ORIGIN] = axis
        return self._insert(0, base)

    def split_link(self, link: int, point: Array, axis: Array, share: float) -> int:
        """Cut a link in two at a point and join the parts by a hinge; mass and inertia are kept."""
        at = int(self.proximal[link])
        whole = self.bodies[at]
        mass, com, inertia = whole[MASS], whole[COM:INERTIA].copy(), _inertia(whole).copy()
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
        whole[MASS], whole[COM:INERTIA], whole[INERTIA:ARMATURE] = near, near_com, bar.ravel()
        if at + 1 < len(self.bodies):
            self.bodies[at + 1, ORIGIN:MASS] -= point
        else:
            self.tool = self.tool - point
        distal = np.zeros(BODY)
        distal[AXIS:ORIGIN], distal[ORIGIN:MASS], distal[MASS] = axis, point, far
        distal[COM:INERTIA], distal[INERTIA:ARMATURE] = far_com - point, rest.ravel()
        return self._insert(at + 1, distal)

    def add_mass(self, mass: float, at: Array) -> None:
        """Fix a point mass to the last body."""
        row = self.bodies[-1]
        total = row[MASS] + mass
        com = (row[MASS] * row[COM:INERTIA] + mass * at) / total
        inertia = (
            _inertia(row) + _shifted(row[MASS], row[COM:INERTIA] - com) + _shifted(mass, at - com)
        )
        row[MASS], row[COM:INERTIA], row[INERTIA:ARMATURE] = total, com, inertia.ravel()


def _inertia(row: Array) -> Array:
    return row[INERTIA:ARMATURE].reshape(3, 3)


def _shifted(mass: float, arm: Array) -> Array:
    """Inertia of a point mass at `arm`, of shape (3, 3)."""
    return mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))


Factors = dict[str, Array]
"""What a true arm is beside its nominal one, each of shape (n,), with the names of `NEUTRAL`."""
RATIOS = ("mass", "inertia", "armature", "damping", "kp", "kv")
"""Factors that are true over nominal."""
NEUTRAL = {
    **dict.fromkeys(RATIOS, 1.0), "x": 0.0, "y": 0.0, "z": 0.0, "zero": 0.0, "shift": 0.0,
    "constant": 1.0, "offset": 0.0,
}  # fmt: skip
"""Factors of an arm that is exactly the nominal one: ratios, shifts of the centre of mass over the
length of the link, error of the encoders' zero [rad or m], time by which commands act late (if
negative early) [s], measured over true torque, its offset over the drive's limit."""


def exactly(joints: int) -> Factors:
    """Factors of an arm that is exactly the nominal one."""
    return {name: np.full(joints, value) for name, value in NEUTRAL.items()}
