"""The simulated arm accelerates as the thesis's equations of motion say, free and in contact.

Body 1 is link 1; body 2 is the motor side of joint 2, its centre of mass on the joint axis;
body 3 is link 2, loose on body 2. The coordinates are the angle of link 1, the angle of body 2
against link 1, and the play: a slide ``d`` in the direction ``beta`` against link 2 (3.43), or,
for backlash, an angle ``delta`` of body 3 against body 2. The printed equations 3.46 to 3.48 hold
as they stand, but for a bracket left open in the last term of 3.47.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import mujoco
import numpy as np
import pytest

from loose_env.arms import Arm, Holding
from loose_env.faults import (
    Backlash,
    Fault,
    SeatKind,
    StructuralLooseness,
    seated_spec,
    set_seat,
)
from loose_env.typing import Array


class Figures(NamedTuple):
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


class Stops(NamedTuple):
    """Two stops: each pushes back with max(0, k r + c v + J dv/dt), r the penetration."""

    gap: float
    stiffness: tuple[float, float]
    damping: tuple[float, float]
    inertance: float = 0.0


LOW = Figures(1, 0.2, 0.05, 0.02, 0.1, 0.001, 0.5, 0.05, 0.005, -np.pi)
HIGH = Figures(6, 0.7, 0.5, 0.3, 2, 0.05, 4, 0.4, 0.1, np.pi)
ARM = Figures(4.0, 0.4, 0.22, 0.06, 0.5, 0.01, 1.5, 0.2, 0.02, 1.1)
WIDE = Stops(1.0, (150.0, 300.0), (3.0, 8.0))
"""A gap so wide that the play matters in the equations' velocity terms."""


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


KINDS: dict[SeatKind, Callable[[Figures, Array, Array], tuple[Array, Array]]] = {
    "slide": loose,
    "play": backlash,
}


def accelerations(
    kind: SeatKind, f: Figures, stops: Stops, q: Array, v: Array, torque: Array
) -> Array:
    """Accelerations under generalised forces (3,), with the stops."""
    mass, force = KINDS[kind](f, q, v)
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


def thesis_arm(f: Figures) -> Arm:
    """The arm of the equations, without gravity, friction, springs or rotors of its own."""

    def inertial(mass: float, centre: float, inertia: float) -> str:
        # Only the inertia about z counts in the plane; the others must fit a rigid body.
        return (
            f'<inertial mass="{mass:.17g}" pos="{centre:.17g} 0 0" '
            f'diaginertia="{inertia:.17g} {inertia:.17g} {inertia:.17g}"/>'
        )

    spec = mujoco.MjSpec.from_string(f"""
        <mujoco><compiler angle="radian"/><option gravity="0 0 0"/><worldbody>
        <body name="link1">{inertial(f.m1, f.lg1, f.i1)}<joint name="joint1" axis="0 0 1"/>
        <body name="flange2" pos="{f.l1:.17g} 0 0">{inertial(f.m2, 0.0, f.i2)}
        <joint name="joint2" axis="0 0 1"/>
        <body name="link2">{inertial(f.m3, f.lg3, f.i3)}<site name="tool"/></body>
        </body></body></worldbody></mujoco>""")
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


def fault(kind: SeatKind, f: Figures, stops: Stops, friction: float = 0.0) -> Fault:
    figures = {**stops._asdict(), "friction": friction}
    del figures["inertance"]
    if kind == "play":
        return Backlash(joint=2, **figures)
    direction = (float(np.cos(f.beta)), float(np.sin(f.beta)), 0.0)
    return StructuralLooseness(link=2, direction=direction, **figures)


def simulated(kind: SeatKind, f: Figures, what: Fault) -> mujoco.MjModel:
    model = seated_spec(thesis_arm(f), 2, kind).compile()
    model.opt.timestep = 1e-4
    set_seat(model, what)
    return model


def forward(model: mujoco.MjModel, q: Array, v: Array, torque: Array) -> Array:
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.qfrc_applied[:] = q, v, torque
    mujoco.mj_forward(model, data)
    return data.qacc.copy()


def stepped(model: mujoco.MjModel, start: Array, until: float, torque: Array) -> Array:
    """Positions (K, nv) at every millisecond."""
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = start[: model.nq], start[model.nq :]
    data.qfrc_applied[:] = torque
    rows = [data.qpos.copy()]
    for _ in range(round(until / 1e-3)):
        mujoco.mj_step(model, data, round(1e-3 / model.opt.timestep))
        rows.append(data.qpos.copy())
    return np.array(rows)


def random_state(rng: np.random.Generator, play: float) -> tuple[Figures, Array, Array, Array]:
    """An arm, its positions, rates and generalised forces at random, with the given play."""
    q = np.array([*rng.uniform(-np.pi, np.pi, 2), play])
    f = Figures(*rng.uniform(LOW, HIGH))
    return f, q, rng.normal(scale=3.0, size=3), rng.normal(scale=5.0, size=3)


@pytest.mark.parametrize("friction", [0.0, 1.2])
@pytest.mark.parametrize("kind", KINDS)
def test_a_loose_arm_in_its_gap_accelerates_as_the_equations_say(
    kind: SeatKind, friction: float
) -> None:
    rng = np.random.default_rng(4)
    for _ in range(50):
        f, q, v, torque = random_state(rng, rng.uniform(-0.49, 0.49))
        # A guide that slides holds back with its friction.
        driven = torque - friction * np.sign(v[2]) * np.eye(3)[2]
        expected = accelerations(kind, f, WIDE, q, v, driven)
        found = forward(simulated(kind, f, fault(kind, f, WIDE, friction)), q, v, torque)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize("kind", KINDS)
def test_a_stop_pushes_back_as_its_law_says(kind: SeatKind) -> None:
    rng = np.random.default_rng(5)
    let_go = 0
    for _ in range(100):
        f, q, v, torque = random_state(rng, rng.choice([-1, 1]) * rng.uniform(0.51, 0.7))
        model = simulated(kind, f, fault(kind, f, WIDE))
        # What the law calls J: 1e-4 of the seat's effective mass, as MuJoCo takes it.
        weight = float(model.tendon_invweight0[model.tendon("seat_low").id])
        stops = WIDE._replace(inertance=1e-4 / (1 - 1e-4) / weight)
        expected = accelerations(kind, f, stops, q, v, torque)
        found = forward(model, q, v, torque)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6 * np.abs(expected).max())
        free = accelerations(kind, f, stops._replace(gap=2.0), q, v, torque)
        let_go += bool(np.allclose(expected, free, rtol=0, atol=1e-9))
    # Stops only push: a link that leaves fast enough is not held back. Both cases came up.
    assert 5 < let_go < 95


@pytest.mark.parametrize("torque", [[3.0, -1.0, 0.0], [0.0, 0.0, 2.0]], ids=["joints", "seat"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_guide_sticks_below_its_friction_and_slides_above_it(
    kind: SeatKind, torque: list[float]
) -> None:
    push, start = np.array(torque), np.array([0.3, 0.9, 0.0, 0.0, 0.0, 0.0])
    mass, _ = KINDS[kind](ARM, start[:3], np.zeros(3))
    # Force across the seat of the arm at rest when the seat is shut.
    pull = abs(float(mass[2, :2] @ np.linalg.solve(mass[:2, :2], push[:2]) - push[2]))

    def travel(friction: float) -> float:
        model = simulated(kind, ARM, fault(kind, ARM, WIDE, friction))
        return float(np.abs(stepped(model, start, 0.05, push)[:, 2]).max())

    free = travel(0.0)
    assert 1e-4 < free < WIDE.gap / 2
    assert travel(1.05 * pull) < 1e-6 * free
    assert 0.02 * free < travel(0.8 * pull) < 0.5 * free
