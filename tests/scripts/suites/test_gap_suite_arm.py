"""The blind arm: it agrees with MuJoCo, keeps its energy, and its effects do what they say."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest

pytest.importorskip("numba")

from scripts.suites.gap.arms import ARMS, GRAVITY, model_xml, planar3, spatial3
from scripts.suites.gap.dynamics import (
    FRICTION,
    LOADED,
    LOADED_SMOOTH,
    LOADED_SPEED,
    SMOOTH_SPEED,
    STRIBECK_SPEED,
    Factors,
    System,
    add_mass,
    build,
    free_link,
    mass_matrix,
    simulate,
    split_link,
)
from scripts.suites.gap.effects import CATALOGUE, KINDS, OUTSIDE, Effect
from scripts.suites.gap.machine import (
    FAMILIES,
    Motion,
    TrueArm,
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
def test_an_arm_without_friction_keeps_its_energy(name):
    figures = ARMS[name]()
    start = (figures.home + 0.2, np.full(figures.joints, 1.5))
    trace = simulate(unpowered(figures), swing(figures), start=start, settle=0.0)
    assert np.ptp(trace.position, axis=0).min() > 0.1
    assert np.ptp(trace.energy) < 1e-7 * np.abs(trace.energy).max()


def test_friction_takes_energy_and_never_gives_any():
    figures = planar3()
    system = unpowered(figures)
    system.laws[1, [FRICTION, STRIBECK_SPEED, SMOOTH_SPEED]] = 0.5, 0.1, 0.01
    start = (figures.home, np.full(3, 1.5))
    energy = simulate(system, swing(figures), start=start, settle=0.0).energy
    assert energy[-1] < energy[0] - 0.1
    assert np.diff(energy).max() < 1e-9


@pytest.mark.parametrize("name", ["joint_compliance", "coulomb_friction", "backlash"])
def test_halving_the_step_changes_less_than_any_sensor_sees(name):
    figures = spatial3()
    arm = exact(figures, some_effect(name, figures, at=0.5, place=1))
    motion = Motion(commands=swing(figures))
    coarse, fine = arm.run(motion, inside=10), arm.run(motion, inside=20)
    assert np.abs(coarse.position - fine.position).max() < 1e-6
    assert np.abs(coarse.velocity - fine.velocity).max() < 1e-4


def test_a_joint_set_free_and_a_link_cut_in_two_weigh_what_they_weighed():
    figures = spatial3()
    system = build(figures, Factors.ones(3))
    whole = mass_matrix(system, figures.home)
    assert free_link(system, 1, "hinge", np.array([0.0, 1.0, 0.0])) == 2
    assert split_link(system, 2, np.array([0.2, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]), 0.55) == 4
    assert system.joint_dofs.tolist() == [0, 1, 3]
    joints = np.ix_(system.joint_dofs, system.joint_dofs)
    np.testing.assert_allclose(mass_matrix(system, figures.home)[joints], whole, rtol=1e-12)


def test_a_payload_is_held_by_its_weight_times_its_lever():
    figures = planar3()
    system = build(figures, Factors.ones(3))
    stretched = np.zeros((50, 3))
    light = simulate(system, stretched, settle=3.0).torque[-1]
    add_mass(system, 2, 1.0, system.tool)
    heavy = simulate(system, stretched, settle=3.0).torque[-1]
    # turning about +y is downwards for a link along x
    np.testing.assert_allclose(light - heavy, GRAVITY * np.array([1.0, 0.6, 0.25]), rtol=0.01)


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


def all_late(figures, delay):
    effect = some_effect("command_delay", figures, place=-1)
    return dataclasses.replace(effect, parameters={"delay": delay})


def ten_samples_late(motion):
    return np.concatenate((np.repeat(motion.commands[:1], 10, axis=0), motion.commands[:-10]))


def test_a_delay_of_ten_samples_is_the_past_of_the_commands():
    figures = planar3()
    motion = Motion(commands=swing(figures))
    effect = all_late(figures, 0.010)
    assert effect.place.name == "all"
    one = exact(figures, effect).run(motion)
    other = exact(figures).run(Motion(commands=ten_samples_late(motion)))
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
    row[[LOADED, LOADED_SPEED, LOADED_SMOOTH]] = 0.2, 1.0, 1e-4
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
