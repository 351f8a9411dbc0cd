"""The generator of blind recordings: it agrees with MuJoCo, and cases are drawn by number."""

from __future__ import annotations

import dataclasses
import json

import mujoco
import numpy as np
import pytest

pytest.importorskip("numba")
pytest.importorskip("pyarrow")

from loose_env.recording import read_recording
from scripts.suites.gap import dynamics as of
from scripts.suites.gap.arms import ARMS, model_xml, planar3, spatial3
from scripts.suites.gap.cases import (
    HELD_OUT,
    VISIBLE,
    Case,
    Visibility,
    draw_case,
    is_written,
    runs_of,
    tolerance_of,
    truth_of,
    visible_size,
    write_case,
)
from scripts.suites.gap.dynamics import (
    TOLERANCE,
    Factors,
    System,
    build,
    simulate,
)
from scripts.suites.gap.effects import CATALOGUE, KINDS, OUTSIDE, Effect
from scripts.suites.gap.grading import Comparison
from scripts.suites.gap.machine import (
    FAMILIES,
    Motion,
    Noise,
    TrueArm,
    add_noise,
    rich_motion,
    shaken_motion,
    steps_inside,
)

pytestmark = pytest.mark.slow

NAMES = list(ARMS)


def swing(figures, seconds: float = 0.8) -> np.ndarray:
    """Commands that move every joint."""
    time = np.arange(round(seconds * 1000)) * 1e-3
    rates = np.array([0.9, 1.3, 1.9, 2.4])[: figures.joints]
    wave = np.sin(2 * np.pi * rates * time[:, None]) * np.minimum(time / 0.3, 1.0)[:, None] ** 2
    return figures.home + 0.3 * figures.reach * wave


def exact(figures, *effects: Effect) -> TrueArm:
    return TrueArm(figures=figures, factors=Factors.ones(figures.joints), effects=effects)


def some_effect(name: str, figures, *, at: float = 0.7, place: int = 0) -> Effect:
    """An effect of a size inside its range (0: least, 1: largest)."""
    kind = KINDS[name]
    where = kind.places(figures)[place]
    drawn = kind.draw(np.random.default_rng(3), figures, where)
    low, high = kind.bounds(figures, where)
    parameters = kind.size(low ** (1 - at) * high**at, drawn, figures, where)
    return Effect(kind=name, place=where, parameters=parameters)


def unpowered(figures) -> System:
    """The arm without drives, damping and friction."""
    system = build(figures, Factors.ones(figures.joints))
    system.laws[:] = 0.0
    system.drives[:, 1:3] = 0.0
    return system


@pytest.mark.parametrize("name", NAMES)
def test_the_nominal_arm_moves_as_mujoco_moves_its_model(name):
    figures = ARMS[name]()
    commands = swing(figures)
    trace = simulate(build(figures, Factors.ones(figures.joints)), commands)
    model = mujoco.MjModel.from_xml_string(model_xml(figures))
    assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = trace.position[0], trace.velocity[0]
    inside = round(1e-3 / model.opt.timestep)
    for k, command in enumerate(commands):
        data.ctrl[:] = command
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(data.qpos, trace.position[k], atol=1e-7)
        np.testing.assert_allclose(data.qvel, trace.velocity[k], atol=1e-5)
        acceleration = data.sensor("tool_acc").data
        np.testing.assert_allclose(acceleration, trace.acceleration[k], atol=1e-3)
        np.testing.assert_allclose(data.actuator_force, trace.torque[k], atol=1e-3)
        mujoco.mj_step(model, data, inside)


@pytest.mark.parametrize("name", NAMES)
def test_an_arm_keeps_its_energy_and_friction_only_takes_some(name):
    figures = ARMS[name]()
    start = (figures.home + 0.2, np.full(figures.joints, 1.5))
    trace = simulate(unpowered(figures), swing(figures), start=start, settle=0.0)
    assert np.ptp(trace.position, axis=0).min() > 0.1
    assert np.ptp(trace.energy) < 1e-7 * np.abs(trace.energy).max()
    system = unpowered(figures)
    system.laws[1, [of.FRICTION, of.STRIBECK_SPEED, of.SMOOTH_SPEED]] = 0.5, 0.1, 0.01
    energy = simulate(system, swing(figures), start=start, settle=0.0).energy
    assert energy[-1] < energy[0] - 1e-3 and np.diff(energy).max() < 1e-9


@pytest.mark.parametrize("name", ["joint_compliance", "coulomb_friction", "backlash"])
def test_halving_the_step_changes_less_than_any_sensor_sees(name):
    figures = spatial3()
    arm = exact(figures, some_effect(name, figures, at=0.5, place=1))
    motion = Motion(commands=swing(figures))
    coarse, fine = arm.run(motion, inside=10), arm.run(motion, inside=20)
    assert np.abs(coarse.position - fine.position).max() < 1e-6
    assert np.abs(coarse.velocity - fine.velocity).max() < 1e-4


@pytest.mark.parametrize("name", [*CATALOGUE, *OUTSIDE])
def test_every_kind_changes_the_readings(name):
    kind = KINDS[name]
    arms = [make() for make in (planar3, spatial3)]
    figures = next(arm for arm in arms if kind.places(arm))
    motion = Motion(commands=swing(figures))
    effect = some_effect(name, figures, at=0.9, place=-1)
    with_it, without = exact(figures, effect).run(motion), exact(figures).run(motion)
    changes = [
        np.abs(getattr(with_it, field.name) - getattr(without, field.name)).max()
        for field in dataclasses.fields(without)
    ]
    assert np.all(np.isfinite(changes))
    assert max(changes) > 1e-3


def test_a_delay_of_ten_samples_is_the_past_of_the_commands():
    figures = planar3()
    commands = swing(figures)
    late = dataclasses.replace(
        some_effect("command_delay", figures, place=-1), parameters={"delay": 0.010}
    )
    assert late.place.name == "all"
    one = exact(figures, late).run(Motion(commands=commands))
    past = np.concatenate((np.repeat(commands[:1], 10, axis=0), commands[:-10]))
    other = exact(figures).run(Motion(commands=past))
    np.testing.assert_allclose(one.position, other.position, atol=1e-9)


def test_a_tilted_planar_arm_is_one_whose_first_encoder_is_off():
    figures = planar3()
    motion = Motion(commands=swing(figures))
    tilt = some_effect("base_tilt", figures, at=0.8)
    offset = some_effect("encoder_offset", figures)
    # a base turned by +angle about y is a first joint that stands further by +angle
    offset = dataclasses.replace(offset, parameters={"offset": -tilt.parameters["y"]})
    one, other = exact(figures, tilt).run(motion), exact(figures, offset).run(motion)
    np.testing.assert_allclose(one.position, other.position, atol=1e-8)
    np.testing.assert_allclose(one.acceleration, other.acceleration, atol=1e-5)


def test_friction_under_load_is_a_share_of_the_torque_that_holds_the_arm():
    figures = planar3()
    system = build(figures, Factors.ones(3))
    time = np.arange(3000) * 1e-3
    slow = figures.home + 0.05 * (time[:, None] / 3.0 - 0.5)
    back = slow[::-1].copy()
    row = system.drives[0]
    row[[of.LOADED, of.LOADED_SPEED, of.LOADED_SMOOTH]] = 0.2, 1.0, 1e-4
    inside = steps_inside(system, figures, 10)
    up, down = (simulate(system, c, inside=inside).torque[1500, 0] for c in (slow, back))
    lighter, heavier = sorted((abs(up), abs(down)))
    # of the torque that moves the arm 0.2 is lost, of the one that is moved by it too
    assert heavier * 0.8 == pytest.approx(lighter * 1.2, rel=0.03)


@pytest.mark.parametrize("name", NAMES)
def test_motions_start_at_rest_and_leave_the_drives_room(name):
    figures = ARMS[name]()
    rng = np.random.default_rng(0)
    limits = np.array([link.limit for link in figures.links])
    for family in FAMILIES:
        motion = rich_motion(rng, figures, family=family, seconds=3.0)
        assert motion.commands.shape == (3000, figures.joints)
        assert np.abs(motion.commands - figures.home).max() < 3 * figures.reach.max()
        assert np.abs(np.diff(motion.commands[:5], axis=0)).max() < 1e-4
        torque = exact(figures).run(motion).torque
        assert np.mean(np.abs(torque) > 0.98 * limits) < 0.02
    shaken = shaken_motion(rng, figures, joint=1, seconds=1.0)
    moving = np.ptp(shaken.commands, axis=0) > 0
    assert moving.tolist() == [j == 1 for j in range(figures.joints)]


@pytest.fixture(scope="module")
def arm() -> TrueArm:
    return TrueArm(figures=planar3(), factors=Factors.draw(3, np.random.default_rng(5)))


@pytest.fixture(scope="module")
def noise() -> Noise:
    return Noise.draw(planar3(), np.random.default_rng(6))


@pytest.fixture(scope="module")
def view(arm, noise) -> Visibility:
    motion = rich_motion(np.random.default_rng(7), arm.figures, family="multisine", seconds=2.0)
    return Visibility(arm, motion, noise, "forward")


def test_a_visible_size_scores_three_and_more_is_more(view):
    kind = KINDS["coulomb_friction"]
    place = kind.places(view.arm.figures)[1]
    drawn = kind.draw(np.random.default_rng(0), view.arm.figures, place)
    size = visible_size(view, kind, place, drawn)
    assert size is not None
    assert view.of(kind, place, drawn, size) == pytest.approx(VISIBLE, rel=0.25)
    assert view.of(kind, place, drawn, 3 * size) > 2 * VISIBLE


def test_what_the_tolerance_explains_is_not_seen_and_a_little_more_is(view):
    """A heavier rotor is a figure of the model as far as the tolerance reaches from there."""
    kind = KINDS["rotor_inertia"]
    for joint, place in enumerate(kind.places(view.arm.figures)):
        armature = view.arm.figures.links[joint].armature
        room = 1 + TOLERANCE - view.arm.factors.armature[joint]
        assert view.of(kind, place, {}, 0.95 * room * armature) < 0.2
        size = visible_size(view, kind, place, {})
        assert size is None or size > room * armature


def test_a_case_is_drawn_by_its_number_alone():
    one, again, other = draw_case(3), draw_case(3), draw_case(4)
    assert truth_of(one) == truth_of(again)
    assert truth_of(one)["factors"] != truth_of(other)["factors"]
    first, second = runs_of(one)[0], runs_of(again)[0]
    for sensor in first.sensors:
        np.testing.assert_array_equal(first.sensors[sensor], second.sensors[sensor])


@pytest.fixture(scope="module")
def friction_case(arm, noise) -> Case:
    kind = KINDS["coulomb_friction"]
    place = kind.places(arm.figures)[0]
    drawn = kind.draw(np.random.default_rng(0), arm.figures, place)
    effect = Effect(
        kind=kind.name, place=place, parameters=kind.size(2.0, drawn, arm.figures, place)
    )
    rng = np.random.default_rng(9)
    runs = tuple(
        rich_motion(rng, arm.figures, family=family, seconds=1.5)
        for family in ("multisine", "steps")
    )
    return Case(
        number=1001,
        form="forward",
        arm=TrueArm(figures=arm.figures, factors=arm.factors, effects=(effect,)),
        motions=runs,
        noise=noise,
        sizes=({"size": 2.0, "visible": 1.0, "ratio": 2.0},),
    )


def test_a_recording_reads_and_tells_nothing(tmp_path, friction_case):
    recordings, truth = tmp_path / "recordings", tmp_path / "truth"
    folder = write_case(friction_case, recordings=recordings, truth=truth)
    recording = read_recording(folder)
    run = recording.runs[0]
    assert run.comparison == "forward"
    assert run.sensors["tool_acc"].shape == (1500, 3)
    assert set(run.controls) == {"motor1", "motor2", "motor3"}
    said = "".join(path.read_text() for path in folder.glob("*.[jx]*"))
    assert not any(word in said for word in ("coulomb", "friction", "planar", "gap", "single"))
    sealed = json.loads((truth / f"{friction_case.name}.json").read_text())
    assert sealed["effects"][0]["kind"] == "coulomb_friction"
    assert is_written(friction_case.name, recordings=recordings, truth=truth)


def test_readings_have_the_noise_and_the_steps_they_are_said_to_have(arm, noise):
    motion = rich_motion(np.random.default_rng(1), arm.figures, family="steps", seconds=2.0)
    clean = arm.run(motion)
    noisy = add_noise(clean, noise, np.random.default_rng(2))
    steps = noisy.position / noise.step
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    error = (noisy.normalised(noise) - clean.normalised(noise)).std(axis=0)
    np.testing.assert_allclose(error, 1.0, atol=0.1)


def test_tilt_and_first_encoder_of_a_planar_arm_are_one_and_friction_is_neither(
    arm, noise, friction_case
):
    kind = KINDS["base_tilt"]
    place = kind.places(arm.figures)[0]
    effect = Effect(kind="base_tilt", place=place, parameters={"angle": 0.02, "x": 0.0, "y": 0.02})
    tilted = Case(
        number=1020,
        form="forward",
        arm=TrueArm(figures=arm.figures, factors=arm.factors, effects=(effect,)),
        motions=friction_case.motions,
        noise=noise,
        sizes=({"size": 0.02, "visible": 0.01, "ratio": 2.0},),
    )
    comparison = Comparison(tilted)
    assert not comparison.separable(0, ("encoder_offset", "joint1"))
    assert comparison.separable(0, ("coulomb_friction", "joint1"))
    assert comparison.separable(0, ("encoder_offset", "nowhere"))


@pytest.mark.parametrize(("number", "count"), [(1011, 1), (3004, 1), (4001, 3), (5001, 5)])
def test_drawn_effects_are_visible_and_at_places_of_their_own(number, count):
    case = draw_case(number)
    effects, most = case.arm.effects, 15 if number == 5001 else count
    assert count <= len(effects) <= most
    assert len({(effect.kind, effect.place.index) for effect in effects}) == len(effects)
    assert all((3.0 if number == 5001 else 1.0) <= s["ratio"] <= 30.0 for s in case.sizes)
    off = np.abs(case.arm.factors.flat() - 1.0)
    assert off.max() <= tolerance_of(number) == (0.10 if number == 5001 else TOLERANCE)
    if count == 1:
        seen = Visibility(case.arm, case.motions[HELD_OUT], case.noise, case.form)
        assert seen.score(seen.excess(seen.difference(effects))) > VISIBLE
