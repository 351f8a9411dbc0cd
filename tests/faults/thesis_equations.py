"""The thesis's two-link arm with a loose second link: its equations, and the same arm in MuJoCo.

Body 1 is link 1; body 2 is the motor side of joint 2, its centre of mass on the joint axis;
body 3 is link 2, loose on body 2. The coordinates are the angle of link 1, the angle of body 2
against link 1, and the play: a slide ``d`` in the direction ``beta`` against link 2 (3.43), or,
for backlash, an angle ``delta`` of body 3 against body 2.

The printed equations 3.46 to 3.48 hold as they stand, but for a bracket left open in the last
term of 3.47. Equation 3.41 holds with its two slips mended: I1 + m1 lc1² in its first term, and
lc2 θ12'' + S2 l1 θ1'² + C2 l1 θ1'' in the bracket after C2.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.integrate import solve_ivp

from loose_env.arms import Arm, Holding
from loose_env.typing import Array

System = Callable[["Figures", Array, Array], tuple[Array, Array]]
"""Inertia matrix and velocity-dependent forces, from the positions and the rates."""


@dataclass(frozen=True, kw_only=True)
class Figures:
    """Masses [kg], lengths [m], inertias about the centres of mass [kg·m²], direction [rad]."""

    m1: float
    l1: float
    lg1: float
    i1: float
    m2: float
    i2: float
    m3: float
    lg3: float
    i3: float
    beta: float

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Figures:
        """An arm like any other, within a factor of a few."""
        return cls(
            m1=rng.uniform(1, 6),
            l1=rng.uniform(0.2, 0.7),
            lg1=rng.uniform(0.05, 0.5),
            i1=rng.uniform(0.02, 0.3),
            m2=rng.uniform(0.1, 2),
            i2=rng.uniform(0.001, 0.05),
            m3=rng.uniform(0.5, 4),
            lg3=rng.uniform(0.05, 0.4),
            i3=rng.uniform(0.005, 0.1),
            beta=rng.uniform(-np.pi, np.pi),
        )


@dataclass(frozen=True, kw_only=True)
class Stops:
    """Two stops: each pushes back with max(0, k r + c v + J dv/dt), r the penetration."""

    gap: float
    stiffness: tuple[float, float]
    damping: tuple[float, float]
    inertance: float = 0.0


def healthy_torques(f: Figures, q: Array, v: Array, a: Array) -> Array:
    """Joint torques of the healthy arm, equation 3.41 with its slips mended."""
    m2 = f.m2 + f.m3
    lc2 = f.m3 * f.lg3 / m2
    i2 = f.i2 + f.m2 * lc2**2 + f.i3 + f.m3 * (f.lg3 - lc2) ** 2
    s2, c2 = np.sin(q[1]), np.cos(q[1])
    v12, a12 = v[0] + v[1], a[0] + a[1]
    torque2 = lc2 * m2 * (lc2 * a12 + f.l1 * (s2 * v[0] ** 2 + c2 * a[0])) + i2 * a12
    torque1 = (
        (f.i1 + f.m1 * f.lg1**2) * a[0]
        + f.l1
        * m2
        * (
            s2 * (-lc2 * v12**2 - c2 * f.l1 * v[0] ** 2 + s2 * f.l1 * a[0])
            + c2 * (lc2 * a12 + s2 * f.l1 * v[0] ** 2 + c2 * f.l1 * a[0])
        )
        + torque2
    )
    return np.array([torque1, torque2])


def loose(f: Figures, q: Array, v: Array) -> tuple[Array, Array]:
    """Equations 3.46 to 3.48 without stops, as inertia matrix and velocity-dependent forces."""
    d = q[2]
    s2, c2 = np.sin(q[1]), np.cos(q[1])
    s2b, c2b = np.sin(q[1] + f.beta), np.cos(q[1] + f.beta)
    sb, cb = np.sin(f.beta), np.cos(f.beta)
    l1, lg3, m3 = f.l1, f.lg3, f.m3
    own = d**2 + lg3 * (2 * d * cb + lg3)
    cross = l1 * (d * c2b + lg3 * c2)
    m11 = f.m1 * f.lg1**2 + f.m2 * l1**2 + f.i1 + f.i2 + f.i3 + m3 * (l1**2 + 2 * cross + own)
    m12 = f.i2 + f.i3 + m3 * (cross + own)
    m22 = f.i2 + f.i3 + m3 * own
    m13, m23 = m3 * (l1 * s2b + lg3 * sb), m3 * lg3 * sb
    v12, turn = v[0] + v[1], l1 * (d * s2b + lg3 * s2)
    force = m3 * np.array(
        [
            2 * v[2] * v12 * (l1 * c2b + lg3 * cb + d) - v[1] * turn * (2 * v[0] + v[1]),
            2 * v[2] * v12 * (d + lg3 * cb) + v[0] ** 2 * turn,
            -(l1 * v[0] ** 2 * c2b + v12**2 * (d + lg3 * cb)),
        ]
    )
    return np.array([[m11, m12, m13], [m12, m22, m23], [m13, m23, m3]]), force


def backlash(f: Figures, q: Array, v: Array) -> tuple[Array, Array]:
    """The arm with play in joint 2 instead of a slide, from Lagrange's equations.

    With phi = θ1 + θ2 + delta the angle of body 3, the kinetic energy is
    T = (m1 lg1² + I1 + (m2 + m3) l1²) θ1'²/2 + I2 (θ1' + θ2')²/2 + (I3 + m3 lg3²) phi'²/2
    + m3 l1 lg3 cos(θ2 + delta) θ1' phi'.
    """
    angle = q[1] + q[2]
    couple = f.m3 * f.l1 * f.lg3
    base = f.m1 * f.lg1**2 + f.i1 + (f.m2 + f.m3) * f.l1**2
    link = f.i3 + f.m3 * f.lg3**2
    # Rows and columns for θ1, θ1 + θ2 and phi, then for the coordinates themselves.
    absolute = np.array(
        [[base, 0, couple * np.cos(angle)], [0, f.i2, 0], [couple * np.cos(angle), 0, link]]
    )
    to_absolute = np.array([[1, 0, 0], [1, 1, 0], [1, 1, 1]])
    rate = to_absolute @ v
    force = couple * np.sin(angle) * np.array([-(rate[2] ** 2), 0, rate[0] ** 2])
    return to_absolute.T @ absolute @ to_absolute, to_absolute.T @ force


def accelerations(
    system: System, f: Figures, stops: Stops, q: Array, v: Array, torque: Array
) -> Array:
    """Accelerations under generalised forces (3,), with the stops."""
    mass, force = system(f, q, v)
    side = int(q[2] > 0)
    sign = 1.0 if side else -1.0
    penetration, rate = sign * q[2] - stops.gap / 2, sign * v[2]
    if penetration > 0:
        push = stops.stiffness[side] * penetration + stops.damping[side] * rate
        pushed = mass.copy()
        pushed[2, 2] += stops.inertance
        held = np.linalg.solve(pushed, torque - force - push * sign * np.eye(3)[2])
        if push + stops.inertance * sign * held[2] > 0:
            return np.asarray(held)
    return np.asarray(np.linalg.solve(mass, torque - force))


def trajectory(
    system: System, f: Figures, stops: Stops, start: Array, times: Array, torque: Array
) -> Array:
    """Positions (K, 3) at the given times, from positions and rates (6,) at the first of them.

    Every passage of a face of the gap, and every moment at which a stop lets go, ends one
    stretch of the integration: no step has a kink inside.
    """

    def slope(_: float, y: Array) -> Array:
        return np.concatenate([y[3:], accelerations(system, f, stops, y[:3], y[3:], torque)])

    def face(_: float, y: Array) -> float:
        return float(abs(y[2]) - stops.gap / 2)

    def grip(_: float, y: Array) -> float:
        side = int(y[2] > 0)
        sign = 1.0 if side else -1.0
        mass, force = system(f, y[:3], y[3:])
        mass[2, 2] += stops.inertance
        push = stops.stiffness[side] * (sign * y[2] - stops.gap / 2)
        push += stops.damping[side] * sign * y[5]
        held = np.linalg.solve(mass, torque - force - push * sign * np.eye(3)[2])
        return float(push + stops.inertance * sign * held[2])

    for event in (face, grip):
        event.terminal = True  # type: ignore[attr-defined]
    result = np.empty((len(times), 3))
    now, state = float(times[0]), np.array(start, dtype=float)
    result[0] = state[:3]
    while now < times[-1]:
        done = solve_ivp(
            slope,
            (now, times[-1]),
            state,
            method="DOP853",
            rtol=1e-10,
            atol=1e-13,
            max_step=5e-4,  # an impact shorter than a step would go unseen
            events=(face, grip),
            dense_output=True,
        )
        end = done.t[-1]
        for k in np.flatnonzero((times > now) & (times <= end)):
            result[k] = done.sol(times[k])[:3]
        now, state = float(end), done.y[:, -1]
        if done.status == 1:
            # Step over the event, or the next stretch would end where it starts.
            over = 1e-12
            state = state + over * slope(now, state)
            now += over
    return result


def thesis_arm(f: Figures) -> Arm:
    """The arm of the equations, without gravity, friction, springs or rotors of its own."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.option.gravity = [0, 0, 0]
    hinge = mujoco.mjtJoint.mjJNT_HINGE

    def body(
        parent: mujoco.MjsBody, name: str, at: float, mass: float, centre: float, inertia: float
    ) -> mujoco.MjsBody:
        # Only the inertia about z counts in the plane; the others must fit a rigid body.
        return parent.add_body(
            name=name,
            pos=[at, 0, 0],
            mass=mass,
            ipos=[centre, 0, 0],
            inertia=[inertia, inertia, inertia],
            explicitinertial=True,
        )

    link1 = body(spec.worldbody, "link1", 0, f.m1, f.lg1, f.i1)
    link1.add_joint(name="joint1", type=hinge, axis=[0, 0, 1])
    flange2 = body(link1, "flange2", f.l1, f.m2, 0, f.i2)
    flange2.add_joint(name="joint2", type=hinge, axis=[0, 0, 1])
    link2 = body(flange2, "link2", 0, f.m3, f.lg3, f.i3)
    link2.add_site(name="tool", pos=[2 * f.lg3, 0, 0])
    none = Holding(stiffness=(0.0, 0.0), damping=(0.0, 0.0))
    return Arm(
        name="thesis",
        spec=spec,
        joints=("joint1", "joint2"),
        seat_bodies=("link1", "link2"),
        tool="tool",
        axes=(0, 1),
        torque_limits=(100.0, 100.0),
        joint_ranges=(None, None),
        levels=(1.0,),
        band=(30.0, 150.0),
        brake=none,
        servo=none,
        centring=none,
        timestep=1e-4,
    )
