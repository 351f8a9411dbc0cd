"""The simulated arm moves as the thesis's equations of motion say, free and in contact."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from loose_env.arms import Arm, Holding
from loose_env.faults import (
    Backlash,
    Fault,
    Healthy,
    SeatKind,
    StructuralLooseness,
    seated_spec,
    set_seat,
)
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


KINDS: dict[SeatKind, System] = {"slide": loose, "play": backlash}
WIDE = Stops(gap=1.0, stiffness=(150.0, 300.0), damping=(3.0, 8.0))
"""A gap so wide that the play matters in the equations' velocity terms."""
ARM = Figures(
    m1=4.0, l1=0.4, lg1=0.22, i1=0.06, m2=0.5, i2=0.01, m3=1.5, lg3=0.2, i3=0.02, beta=1.1
)


def fault(kind: SeatKind, f: Figures, stops: Stops, friction: float = 0.0) -> Fault:
    if kind == "play":
        return Backlash(
            joint=2,
            gap=stops.gap,
            stiffness=stops.stiffness,
            damping=stops.damping,
            friction=friction,
        )
    return StructuralLooseness(
        link=2,
        direction=(np.cos(f.beta), np.sin(f.beta), 0.0),
        gap=stops.gap,
        stiffness=stops.stiffness,
        damping=stops.damping,
        friction=friction,
    )


def simulated(kind: SeatKind, f: Figures, what: Fault, step: float = 1e-4) -> mujoco.MjModel:
    model = seated_spec(thesis_arm(f), 2, kind).compile()
    model.opt.timestep = step
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
    model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    set_seat(model, what)
    return model


def inertance(model: mujoco.MjModel) -> float:
    """What the stop law calls J: 1e-4 of the seat's effective mass, as MuJoCo takes it."""
    return float(1e-4 / (1 - 1e-4) / model.tendon_invweight0[model.tendon("seat_low").id])


def forward(model: mujoco.MjModel, q: Array, v: Array, torque: Array) -> Array:
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.qfrc_applied[:] = q, v, torque
    mujoco.mj_forward(model, data)
    return data.qacc.copy()


def stepped(
    model: mujoco.MjModel, start: Array, every: float, until: float, torque: Array
) -> Array:
    """Positions (K, nv) at every multiple of `every`, from 0 to `until`."""
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = start[: model.nq], start[model.nq :]
    data.qfrc_applied[:] = torque
    steps = round(every / model.opt.timestep)
    rows = [data.qpos.copy()]
    for _ in range(round(until / every)):
        for _ in range(steps):
            mujoco.mj_step(model, data)
        rows.append(data.qpos.copy())
    return np.array(rows)


def random_state(rng: np.random.Generator, play: float) -> tuple[Array, Array, Array]:
    """Positions, rates and generalised forces at random, with the given play."""
    q = np.array([*rng.uniform(-np.pi, np.pi, 2), play])
    return q, rng.normal(scale=3.0, size=3), rng.normal(scale=5.0, size=3)


def test_the_bare_arm_accelerates_as_equation_3_41_says() -> None:
    rng = np.random.default_rng(3)
    for _ in range(50):
        f = Figures.draw(rng)
        q, v, torque = (part[:2] for part in random_state(rng, 0.0))
        a = forward(thesis_arm(f).model, q, v, torque)
        scale = np.abs(torque).max() + np.abs(healthy_torques(f, q, v, 0 * a)).max()
        np.testing.assert_allclose(healthy_torques(f, q, v, a), torque, atol=1e-6 * scale, rtol=0)


def test_an_arm_with_a_shut_slide_moves_as_equation_3_41_says() -> None:
    f, torque = ARM, np.array([3.0, -1.0, 0.0])
    start = np.array([0.3, 0.9, 0.0, 1.0, -2.0, 0.0])
    with_seat = stepped(simulated("slide", f, Healthy()), start, 0.01, 0.2, torque)
    bare = thesis_arm(f).model
    bare.opt.timestep = 1e-4
    without = stepped(bare, start[[0, 1, 3, 4]], 0.01, 0.2, torque[:2])
    moved = np.abs(without - without[0]).max()
    np.testing.assert_allclose(with_seat[:, :2], without, rtol=0, atol=1e-6 * moved)
    assert np.abs(with_seat[:, 2]).max() < 1e-9


@pytest.mark.parametrize("driven", [False, True], ids=["no torque", "torque"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_loose_arm_in_its_gap_accelerates_as_the_equations_say(
    kind: SeatKind, driven: bool
) -> None:
    rng = np.random.default_rng(4)
    for _ in range(50):
        f = Figures.draw(rng)
        q, v, torque = random_state(rng, rng.uniform(-0.49, 0.49))
        torque *= driven
        expected = accelerations(KINDS[kind], f, WIDE, q, v, torque)
        found = forward(simulated(kind, f, fault(kind, f, WIDE)), q, v, torque)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize("kind", KINDS)
def test_a_stop_pushes_back_as_its_law_says(kind: SeatKind) -> None:
    rng = np.random.default_rng(5)
    let_go = 0
    for _ in range(100):
        f = Figures.draw(rng)
        q, v, torque = random_state(rng, rng.choice([-1, 1]) * rng.uniform(0.51, 0.7))
        model = simulated(kind, f, fault(kind, f, WIDE))
        stops = replace(WIDE, inertance=inertance(model))
        expected = accelerations(KINDS[kind], f, stops, q, v, torque)
        found = forward(model, q, v, torque)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6 * np.abs(expected).max())
        free = accelerations(KINDS[kind], f, replace(stops, gap=2.0), q, v, torque)
        let_go += bool(np.allclose(expected, free, rtol=0, atol=1e-9))
    # Stops only push: a link that leaves fast enough is not held back. Both cases came up.
    assert 5 < let_go < 95


CONTACTS: dict[SeatKind, Stops] = {
    "slide": Stops(gap=2e-3, stiffness=(6e4, 2.5e4), damping=(12.0, 30.0)),
    "play": Stops(gap=4e-3, stiffness=(700.0, 1500.0), damping=(0.15, 0.5)),
}
STARTS = {
    "slide": np.array([0.3, 0.9, 0.0, 1.0, -2.0, 0.4]),
    "play": np.array([0.3, 0.9, 0.0, 1.0, -2.0, 2.0]),
}
TORQUE = np.array([3.0, -1.0, 0.0])
UNTIL, EVERY = 0.08, 1e-3


def errors_by_step(
    kind: SeatKind, stops: Stops, start: Array, expected: Array
) -> tuple[Array, Array]:
    """Rms errors of the joints [rad] and of the play, at steps halved five times."""
    joints, play = [], []
    for halvings in range(6):
        model = simulated(kind, ARM, fault(kind, ARM, stops), 2e-4 / 2**halvings)
        error = stepped(model, start, EVERY, UNTIL, TORQUE) - expected
        joints.append(np.sqrt(np.mean(error[:, :2] ** 2)))
        play.append(np.sqrt(np.mean(error[:, 2] ** 2)))
    return np.array(joints), np.array(play)


def order(errors: Array) -> float:
    """Power of the step with which the error falls."""
    return float(-np.polyfit(np.arange(len(errors)), np.log2(errors), 1)[0])


@pytest.mark.parametrize("kind", KINDS)
def test_free_motion_converges_to_the_equations_in_proportion_to_the_step(kind: SeatKind) -> None:
    start, times = STARTS[kind], np.arange(81) * EVERY
    expected = trajectory(KINDS[kind], ARM, WIDE, start, times, TORQUE)
    assert np.abs(expected[:, 2]).max() < WIDE.gap / 2, "this start should touch no stop"
    joints, play = errors_by_step(kind, WIDE, start, expected)
    for errors in (joints, play):
        np.testing.assert_allclose(errors[:-1] / errors[1:], 2.0, rtol=0.05)
    assert joints[-1] < 1e-4 * np.ptp(expected[:, :2], axis=0).max()
    assert play[-1] < 1e-4 * np.ptp(expected[:, 2])


@pytest.mark.parametrize("kind", KINDS)
def test_impacts_converge_to_the_equations_in_proportion_to_the_step(kind: SeatKind) -> None:
    stops, start = CONTACTS[kind], STARTS[kind]
    times = np.arange(81) * EVERY
    model = simulated(kind, ARM, fault(kind, ARM, stops))
    stops = replace(stops, inertance=inertance(model))
    expected = trajectory(KINDS[kind], ARM, stops, start, times, TORQUE)
    side = np.sign(expected[:, 2]) * (np.abs(expected[:, 2]) > stops.gap / 2)
    entries = side[1:][(side[1:] != 0) & (side[:-1] != side[1:])]
    assert min(np.sum(entries > 0), np.sum(entries < 0)) >= 2, "both stops are to be struck twice"
    joints, play = errors_by_step(kind, stops, start, expected)
    # Where in a step an impact falls is chance, so single ratios scatter about 2.
    assert order(joints) == pytest.approx(1.0, abs=0.1)
    assert order(play) == pytest.approx(1.0, abs=0.3)
    assert joints[-1] < 1e-4 * np.ptp(expected[:, :2], axis=0).max()
    assert play[-1] < 1e-3 * stops.gap


def pull_on_the_seat(kind: SeatKind, torque: Array) -> float:
    """Force across the seat of the arm at rest when the seat is shut."""
    mass, _ = KINDS[kind](ARM, np.array([0.3, 0.9, 0.0]), np.zeros(3))
    joints = np.linalg.solve(mass[:2, :2], torque[:2])
    return abs(float(mass[2, :2] @ joints - torque[2]))


@pytest.mark.parametrize("torque", [[3.0, -1.0, 0.0], [0.0, 0.0, 2.0]], ids=["joints", "seat"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_guide_sticks_below_its_friction_and_slides_above_it(
    kind: SeatKind, torque: list[float]
) -> None:
    push = np.array(torque)
    start = np.array([0.3, 0.9, 0.0, 0.0, 0.0, 0.0])
    pull = pull_on_the_seat(kind, push)

    def travel(friction: float) -> float:
        model = simulated(kind, ARM, fault(kind, ARM, WIDE, friction))
        return float(np.abs(stepped(model, start, EVERY, 0.05, push)[:, 2]).max())

    free = travel(0.0)
    assert 1e-4 < free < WIDE.gap / 2
    assert travel(1.05 * pull) < 1e-6 * free
    assert 0.02 * free < travel(0.8 * pull) < 0.5 * free


@pytest.mark.parametrize("kind", KINDS)
def test_a_sliding_guide_holds_back_with_its_friction(kind: SeatKind) -> None:
    push, friction = np.array([0.0, 0.0, 2.0]), 1.2
    start, times = np.array([0.3, 0.9, 0.0, 0.0, 0.0, 0.0]), np.arange(51) * EVERY
    slowed = push - np.array([0.0, 0.0, friction])
    expected = trajectory(KINDS[kind], ARM, WIDE, start, times, slowed)
    model = simulated(kind, ARM, fault(kind, ARM, WIDE, friction), 2e-5)
    found = stepped(model, start, EVERY, 0.05, push)
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-3 * np.ptp(expected[:, 2]))
