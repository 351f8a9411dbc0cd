"""The true arm as arrays: laws in its joints, equations of motion, integration in time."""

from __future__ import annotations

import dataclasses

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
HYSTERESIS, STROKE = 19, 20
"""Torque of the hysteresis and the travel over which it turns."""
ASYMMETRY = 22
"""Excess of the friction in the positive direction over the mean of both directions."""
GRAIN = 23
"""Waves per turn by which the friction varies from none to twice its mean (0: not); their phase."""
LAWS = 25

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
ACTUATOR = 18


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
        force -= law[19] * z
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
_R, _O, _W, _V, _AL, _AO, _C = 0, 9, 12, 15, 18, 21, 24
# rotation (9), origin (3), joint's motion vector about the world's origin (w 3, v 3), angular
# acceleration (3), acceleration of the origin (3), centre of mass (3); angular velocity at 27 (3)
_OM = 27


@njit(cache=True, fastmath=False)
def forward(bodies, q, v, gravity, work):  # type: ignore[no-untyped-def]
    """Poses, velocities and accelerations of the bodies without joint accelerations."""
    n = q.shape[0]
    p00, p01, p02, p10, p11, p12, p20, p21, p22 = 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0
    ox, oy, oz = 0.0, 0.0, 0.0
    wx, wy, wz = 0.0, 0.0, 0.0
    lx, ly, lz = 0.0, 0.0, 0.0
    ax, ay, az = -gravity[0], -gravity[1], -gravity[2]
    for k in range(n):
        b = bodies[k]
        s = work[k]
        ux, uy, uz = b[1], b[2], b[3]
        # the joint's axis in the world: turning about it leaves it where it is
        gx = p00 * ux + p01 * uy + p02 * uz
        gy = p10 * ux + p11 * uy + p12 * uz
        gz = p20 * ux + p21 * uy + p22 * uz
        rx = p00 * b[4] + p01 * b[5] + p02 * b[6]
        ry = p10 * b[4] + p11 * b[5] + p12 * b[6]
        rz = p20 * b[4] + p21 * b[5] + p22 * b[6]
        slide = b[0] > 0.5
        if slide:
            rx += gx * q[k]
            ry += gy * q[k]
            rz += gz * q[k]
        ox += rx
        oy += ry
        oz += rz
        # acceleration carried from the parent to the new origin
        cx = wy * rz - wz * ry
        cy = wz * rx - wx * rz
        cz = wx * ry - wy * rx
        ax += ly * rz - lz * ry + wy * cz - wz * cy
        ay += lz * rx - lx * rz + wz * cx - wx * cz
        az += lx * ry - ly * rx + wx * cy - wy * cx
        qd = v[k]
        if slide:
            ax += 2.0 * (wy * gz - wz * gy) * qd
            ay += 2.0 * (wz * gx - wx * gz) * qd
            az += 2.0 * (wx * gy - wy * gx) * qd
            s[12], s[13], s[14] = 0.0, 0.0, 0.0
            s[15], s[16], s[17] = gx, gy, gz
        else:
            lx += (wy * gz - wz * gy) * qd
            ly += (wz * gx - wx * gz) * qd
            lz += (wx * gy - wy * gx) * qd
            wx += gx * qd
            wy += gy * qd
            wz += gz * qd
            s[12], s[13], s[14] = gx, gy, gz
            s[15] = oy * gz - oz * gy
            s[16] = oz * gx - ox * gz
            s[17] = ox * gy - oy * gx
            sn, cs = np.sin(q[k]), np.cos(q[k])
            t = 1.0 - cs
            r00 = cs + t * ux * ux
            r01 = t * ux * uy - sn * uz
            r02 = t * ux * uz + sn * uy
            r10 = t * ux * uy + sn * uz
            r11 = cs + t * uy * uy
            r12 = t * uy * uz - sn * ux
            r20 = t * ux * uz - sn * uy
            r21 = t * uy * uz + sn * ux
            r22 = cs + t * uz * uz
            n00 = p00 * r00 + p01 * r10 + p02 * r20
            n01 = p00 * r01 + p01 * r11 + p02 * r21
            n02 = p00 * r02 + p01 * r12 + p02 * r22
            n10 = p10 * r00 + p11 * r10 + p12 * r20
            n11 = p10 * r01 + p11 * r11 + p12 * r21
            n12 = p10 * r02 + p11 * r12 + p12 * r22
            n20 = p20 * r00 + p21 * r10 + p22 * r20
            n21 = p20 * r01 + p21 * r11 + p22 * r21
            n22 = p20 * r02 + p21 * r12 + p22 * r22
            p00, p01, p02 = n00, n01, n02
            p10, p11, p12 = n10, n11, n12
            p20, p21, p22 = n20, n21, n22
        s[0], s[1], s[2] = p00, p01, p02
        s[3], s[4], s[5] = p10, p11, p12
        s[6], s[7], s[8] = p20, p21, p22
        s[9], s[10], s[11] = ox, oy, oz
        s[18], s[19], s[20] = lx, ly, lz
        s[21], s[22], s[23] = ax, ay, az
        s[27], s[28], s[29] = wx, wy, wz


@njit(cache=True, fastmath=False)
def mass_and_bias(bodies, work, mass, bias):  # type: ignore[no-untyped-def]
    """Mass matrix and bias forces (gravity, Coriolis, centrifugal) after `forward`."""
    n = bodies.shape[0]
    m = 0.0
    hx, hy, hz = 0.0, 0.0, 0.0
    xx, yy, zz, xy, xz, yz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    fx, fy, fz, nx, ny, nz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(n - 1, -1, -1):
        b = bodies[k]
        s = work[k]
        mk = b[7]
        if mk > 0.0 or b[11] > 0.0:
            r00, r01, r02, r10, r11, r12, r20, r21, r22 = (
                s[0], s[1], s[2], s[3], s[4], s[5], s[6], s[7], s[8],
            )  # fmt: skip
            dx = r00 * b[8] + r01 * b[9] + r02 * b[10]
            dy = r10 * b[8] + r11 * b[9] + r12 * b[10]
            dz = r20 * b[8] + r21 * b[9] + r22 * b[10]
            px, py, pz = s[9] + dx, s[10] + dy, s[11] + dz
            # rows of R I, then (R I) R'
            a0 = r00 * b[11] + r01 * b[14] + r02 * b[17]
            a1 = r00 * b[12] + r01 * b[15] + r02 * b[18]
            a2 = r00 * b[13] + r01 * b[16] + r02 * b[19]
            b0 = r10 * b[11] + r11 * b[14] + r12 * b[17]
            b1 = r10 * b[12] + r11 * b[15] + r12 * b[18]
            b2 = r10 * b[13] + r11 * b[16] + r12 * b[19]
            c0 = r20 * b[11] + r21 * b[14] + r22 * b[17]
            c1 = r20 * b[12] + r21 * b[15] + r22 * b[18]
            c2 = r20 * b[13] + r21 * b[16] + r22 * b[19]
            ixx = a0 * r00 + a1 * r01 + a2 * r02
            ixy = a0 * r10 + a1 * r11 + a2 * r12
            ixz = a0 * r20 + a1 * r21 + a2 * r22
            iyy = b0 * r10 + b1 * r11 + b2 * r12
            iyz = b0 * r20 + b1 * r21 + b2 * r22
            izz = c0 * r20 + c1 * r21 + c2 * r22
            lx, ly, lz = s[18], s[19], s[20]
            wx, wy, wz = s[27], s[28], s[29]
            cx = wy * dz - wz * dy
            cy = wz * dx - wx * dz
            cz = wx * dy - wy * dx
            qx = mk * (s[21] + ly * dz - lz * dy + wy * cz - wz * cy)
            qy = mk * (s[22] + lz * dx - lx * dz + wz * cx - wx * cz)
            qz = mk * (s[23] + lx * dy - ly * dx + wx * cy - wy * cx)
            ex = ixx * wx + ixy * wy + ixz * wz
            ey = ixy * wx + iyy * wy + iyz * wz
            ez = ixz * wx + iyz * wy + izz * wz
            fx += qx
            fy += qy
            fz += qz
            nx += ixx * lx + ixy * ly + ixz * lz + wy * ez - wz * ey + py * qz - pz * qy
            ny += ixy * lx + iyy * ly + iyz * lz + wz * ex - wx * ez + pz * qx - px * qz
            nz += ixz * lx + iyz * ly + izz * lz + wx * ey - wy * ex + px * qy - py * qx
            m += mk
            hx += mk * px
            hy += mk * py
            hz += mk * pz
            xx += ixx + mk * (py * py + pz * pz)
            yy += iyy + mk * (px * px + pz * pz)
            zz += izz + mk * (px * px + py * py)
            xy += ixy - mk * px * py
            xz += ixz - mk * px * pz
            yz += iyz - mk * py * pz
        wx, wy, wz, vx, vy, vz = s[12], s[13], s[14], s[15], s[16], s[17]
        bias[k] = wx * nx + wy * ny + wz * nz + vx * fx + vy * fy + vz * fz
        gx = m * vx + wy * hz - wz * hy
        gy = m * vy + wz * hx - wx * hz
        gz = m * vz + wx * hy - wy * hx
        kx = xx * wx + xy * wy + xz * wz + hy * vz - hz * vy
        ky = xy * wx + yy * wy + yz * wz + hz * vx - hx * vz
        kz = xz * wx + yz * wy + zz * wz + hx * vy - hy * vx
        for j in range(k + 1):
            t = work[j]
            e = t[12] * kx + t[13] * ky + t[14] * kz + t[15] * gx + t[16] * gy + t[17] * gz
            mass[k, j] = e
            mass[j, k] = e
        mass[k, k] += b[20]


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
def add_tool_force(work, tool, local, force):  # type: ignore[no-untyped-def]
    """Add the joint forces of a force at the tool, given in the tool's frame, to `force`."""
    n = work.shape[0]
    s = work[n - 1]
    px = s[9] + s[0] * tool[0] + s[1] * tool[1] + s[2] * tool[2]
    py = s[10] + s[3] * tool[0] + s[4] * tool[1] + s[5] * tool[2]
    pz = s[11] + s[6] * tool[0] + s[7] * tool[1] + s[8] * tool[2]
    fx = s[0] * local[0] + s[1] * local[1] + s[2] * local[2]
    fy = s[3] * local[0] + s[4] * local[1] + s[5] * local[2]
    fz = s[6] * local[0] + s[7] * local[1] + s[8] * local[2]
    nx, ny, nz = py * fz - pz * fy, pz * fx - px * fz, px * fy - py * fx
    for k in range(n):
        t = work[k]
        force[k] += t[12] * nx + t[13] * ny + t[14] * nz + t[15] * fx + t[16] * fy + t[17] * fz


@njit(cache=True, fastmath=False)
def add_weight(bodies, work, body, share, gravity, force):  # type: ignore[no-untyped-def]
    """Add the joint forces of a share of a body's weight, at its centre of mass, to `force`."""
    s, b = work[body], bodies[body]
    px = s[9] + s[0] * b[8] + s[1] * b[9] + s[2] * b[10]
    py = s[10] + s[3] * b[8] + s[4] * b[9] + s[5] * b[10]
    pz = s[11] + s[6] * b[8] + s[7] * b[9] + s[8] * b[10]
    fx, fy, fz = share * b[7] * gravity[0], share * b[7] * gravity[1], share * b[7] * gravity[2]
    nx, ny, nz = py * fz - pz * fy, pz * fx - px * fz, px * fy - py * fx
    for k in range(body + 1):
        t = work[k]
        force[k] += t[12] * nx + t[13] * ny + t[14] * nz + t[15] * fx + t[16] * fy + t[17] * fz


@njit(cache=True, fastmath=False)
def tool_acceleration(work, tool, acceleration, out):  # type: ignore[no-untyped-def]
    """Proper acceleration of the tool in the last link's frame, after `forward`."""
    n = work.shape[0]
    s = work[n - 1]
    lx, ly, lz = s[18], s[19], s[20]
    wx, wy, wz = s[27], s[28], s[29]
    dx = s[0] * tool[0] + s[1] * tool[1] + s[2] * tool[2]
    dy = s[3] * tool[0] + s[4] * tool[1] + s[5] * tool[2]
    dz = s[6] * tool[0] + s[7] * tool[1] + s[8] * tool[2]
    px, py, pz = s[9] + dx, s[10] + dy, s[11] + dz
    cx = wy * dz - wz * dy
    cy = wz * dx - wx * dz
    cz = wx * dy - wy * dx
    ax = s[21] + ly * dz - lz * dy + wy * cz - wz * cy
    ay = s[22] + lz * dx - lx * dz + wz * cx - wx * cz
    az = s[23] + lx * dy - ly * dx + wx * cy - wy * cx
    for k in range(n):
        t = work[k]
        a = acceleration[k]
        ax += a * (t[15] + t[13] * pz - t[14] * py)
        ay += a * (t[16] + t[14] * px - t[12] * pz)
        az += a * (t[17] + t[12] * py - t[13] * px)
    out[0] = s[0] * ax + s[3] * ay + s[6] * az
    out[1] = s[1] * ax + s[4] * ay + s[7] * az
    out[2] = s[2] * ax + s[5] * ay + s[8] * az


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
    bodies, laws, drives, gravity, tool, cable, fan, powered, sampled, held, command, time, q, v,
    lag, z, work, mass, force, torque, rate, a, dlag, dz,
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
        if sampled:
            torque[j] = held[j]
        elif powered:
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
    every, straight, servo,
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
    period, delay = int(servo[0]), int(servo[1])
    sampled = period > 0
    waiting, asked, held = np.zeros((8, n)), np.zeros(n), np.zeros(n)
    before, estimate = np.zeros(n), np.zeros(n)
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
        if sampled and i % period == 0:
            turn = (i // period) % 8
            for j in range(n):
                k, first = int(drives[j, 0]), i == -settle * inside
                measured = q[k]
                if servo[3] > 0.0:
                    measured = np.round(measured / servo[3]) * servo[3]
                if not first:
                    speed = (measured - before[j]) / (period * step)
                    estimate[j] += servo[2] * (speed - estimate[j])
                before[j] = measured
                asked[j] = drives[j, 1] * (there[j] - measured) - drives[j, 2] * estimate[j]
                asked[j] = min(max(asked[j], -drives[j, 3]), drives[j, 3])
                if first:
                    waiting[:, j] = asked[j]
                waiting[turn, j] = asked[j]
                held[j] = waiting[(turn - delay) % 8, j]
        if i >= 0 and i % every == 0 and row < rows:
            # sensors read what is there at their moment, not what comes within the step
            _derivative(
                bodies, laws, drives, gravity, tool, cable, fan, on, sampled, held, there, time, q,
                v, lag, z, work, mass, force, torque, rate, a[0], dlag[0], dz[0],
            )  # fmt: skip
            tool_acceleration(work, tool, a[0], acceleration)
            for j in range(n):
                k = int(drives[j, 0])
                error, slope = encoder(drives[j], q[k])
                out[row, j] = q[k] + error
                out[row, n + j] = v[k] * (1.0 + slope)
                out[row, 2 * n + 3 + j] = asked[j] if sampled else torque[j]
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
                bodies, laws, drives, gravity, tool, cable, fan, on, sampled, held, command, t, q1,
                v1, lag1, z1, work, mass, force, torque, rate, a[stage], dlag[stage], dz[stage],
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
    servo: tuple[int, int, float, float] = (0, 0, 1.0, 0.0),
) -> Trace:
    """Run an arm through a list of commands, a millisecond apart.

    ``servo`` samples the drives: steps between samples (0: continuous), samples of delay (at most
    7), share of a new velocity in the filtered one, step of the encoders [rad].
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
        1 if fine else inside, straight, np.array(servo, dtype=float),
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
