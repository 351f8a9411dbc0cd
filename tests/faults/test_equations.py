"""The simulated arm moves as the thesis's equations of motion say, free and in contact."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

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
from tests.faults.thesis_equations import (
    Figures,
    Stops,
    System,
    accelerations,
    backlash,
    healthy_torques,
    loose,
    thesis_arm,
    trajectory,
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
