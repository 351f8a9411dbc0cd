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
    draw_case,
    is_written,
    runs_of,
    truth_of,
    write_case,
)
from scripts.suites.gap.dynamics import (
    Factors,
    System,
    build,
    simulate,
)
from scripts.suites.gap.effects import CATALOGUE, KINDS, OUTSIDE, Effect
from scripts.suites.gap.machine import (
    Motion,
    TrueArm,
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


def test_a_case_is_drawn_by_its_number_alone():
    one, again, other = draw_case(3), draw_case(3), draw_case(4)
    assert truth_of(one) == truth_of(again)
    assert truth_of(one)["factors"] != truth_of(other)["factors"]
    first, second = runs_of(one)[0], runs_of(again)[0]
    for sensor in first.sensors:
        np.testing.assert_array_equal(first.sensors[sensor], second.sensors[sensor])


def test_a_recording_reads_and_tells_nothing(tmp_path):
    recordings, truth, case = tmp_path / "recordings", tmp_path / "truth", draw_case(1264)
    folder = write_case(case, recordings=recordings, truth=truth)
    assert read_recording(folder).runs[0].comparison == case.form
    (effect,) = json.loads((truth / f"{case.name}.json").read_text())["effects"]
    said = "".join(path.read_text() for path in folder.glob("*.[jx]*"))
    assert not any(word in said for word in (effect["kind"], "friction", "gap", "single"))
    assert is_written(case.name, recordings=recordings, truth=truth)
