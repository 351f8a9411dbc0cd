"""The generator of blind recordings: it agrees with MuJoCo, and cases are drawn by number."""

from __future__ import annotations

import dataclasses
import json

import mujoco
import numpy as np
import pytest

pytest.importorskip("numba")
pytest.importorskip("pyarrow")

from loose_env.errors import InvalidSetting
from loose_env.recording import read_recording
from scripts.suites.blind import FIRST_JUDGED
from scripts.suites.gap.arms import MACHINES, model_xml
from scripts.suites.gap.cases import (
    VISIBLE,
    draw_case,
    made,
    role_of,
    runs_of,
    seed_of,
    truth_of,
    world_of,
)
from scripts.suites.gap.dynamics import exactly
from scripts.suites.gap.effects import CATALOGUE, KINDS, OUTSIDE, Effect, Spot, drawn
from scripts.suites.gap.worlds import SAMPLE, TOLERANCES, Motion, Noise, Setup

pytestmark = pytest.mark.slow


def swing(machine, seconds: float = 0.8) -> np.ndarray:
    """Commands that move every joint."""
    time = np.arange(round(seconds * 1000)) * 1e-3
    rates = np.linspace(0.9, 2.4, 7)[: machine.joints]
    wave = np.sin(2 * np.pi * rates * time[:, None]) * np.minimum(time / 0.3, 1.0)[:, None] ** 2
    return machine.home + 0.3 * machine.reach * wave


def exact(machine, *effects: Effect) -> Setup:
    noise = Noise.draw(machine, np.random.default_rng(0), SAMPLE)
    return Setup(machine=machine, factors=exactly(machine.joints), effects=effects, noise=noise)


@pytest.mark.parametrize("name", list(MACHINES))
def test_the_nominal_arm_moves_as_mujoco_moves_its_model(name):
    machine = MACHINES[name]
    commands = swing(machine)
    trace = exact(machine).run(Motion(commands=commands))
    model = mujoco.MjModel.from_xml_string(model_xml(machine))
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


@pytest.mark.parametrize("name", [*CATALOGUE, *OUTSIDE])
def test_every_kind_changes_the_readings(name):
    kind = KINDS[name]
    machine = next(m for m in (MACHINES["planar3"], MACHINES["spatial3"]) if kind.places(m))
    motion = Motion(commands=swing(machine))
    effect = drawn(name, Spot(machine, kind.places(machine)[-1], np.random.default_rng(3)), 0.9)
    with_it, without = exact(machine, effect).run(motion), exact(machine).run(motion)
    changes = [np.abs(a - b).max() for a, b in zip(with_it, without, strict=True)]
    assert np.all(np.isfinite(changes))
    assert max(changes) > 1e-3


def test_a_coupled_motor_shares_its_torque_and_a_sampled_servo_still_follows():
    machine = MACHINES["elbow4"]
    motion = Motion(commands=swing(machine))
    free = exact(machine).run(motion)
    sampled = dataclasses.replace(exact(machine), servo=(2000.0, 1.0, 0.5)).run(motion)
    assert 0 < np.abs(sampled.position - free.position).max() < 5e-3
    coupled = dataclasses.replace(exact(machine), coupling=(1.0, 0.0, 0.0)).run(motion)
    np.testing.assert_allclose(
        coupled.torque[:, 2] + coupled.torque[:, 3], free.torque[:, 2], atol=1e-9
    )


def test_friction_behind_slack_gives_nothing_inside_it_and_slides_at_its_bound():
    machine = MACHINES["turntable1"]
    at = KINDS["friction_behind_slack"].places(machine)[0]
    law = {"torque": 4.0, "slack": 0.2, "elastic": 0.02}
    motion = Motion(commands=np.linspace(0.0, 1.0, 3000)[:, None])
    with_it, without = (
        exact(machine, *effects).run(motion).torque[:, 0]
        for effects in ([Effect(kind="friction_behind_slack", place=at, parameters=law)], [])
    )
    more = with_it - without
    assert np.abs(more[:200]).max() < 1e-6 and more[-1] == pytest.approx(4.0, abs=0.05)


def test_a_case_is_drawn_by_its_number_alone_and_a_judged_one_by_its_phrase():
    one, again, other = draw_case(3), draw_case(3), draw_case(9)
    assert truth_of(one) == truth_of(again)
    assert truth_of(one)["factors"] != truth_of(other)["factors"]
    first, second = runs_of(one)[0], runs_of(again)[0]
    for sensor in first.sensors:
        np.testing.assert_array_equal(first.sensors[sensor], second.sensors[sensor])
    assert seed_of(FIRST_JUDGED, "a") != seed_of(FIRST_JUDGED, "b")
    with pytest.raises(InvalidSetting, match="--phrase"):
        seed_of(FIRST_JUDGED)
    assert len({(world_of(n), role_of(n)) for n in range(60)}) == 30


@pytest.mark.parametrize("number", range(6))
def test_a_recording_of_each_world_reads_and_tells_nothing(number, tmp_path):
    name = made(number, "", tmp_path)
    folder, truth = tmp_path / "recordings" / name, tmp_path / "truth" / f"{name}.json"
    sealed, written = json.loads(truth.read_text()), truth.stat().st_mtime_ns
    found = read_recording(folder)
    assert len(found.runs) == 4 and found.model().nv == sealed["joints"]
    (effect,) = sealed["effects"]
    said = "".join(path.read_text() for path in folder.glob("*.[jx]*"))
    assert not any(word in said for word in (effect["kind"], "friction", "gap", sealed["world"]))
    assert made(number, "", tmp_path) == name and truth.stat().st_mtime_ns == written
    assert effect["visible"] >= VISIBLE
    assert [effect["kind"], effect["where"]] == effect["accept"][0][0]
    if sealed["world"] in ("servo", "torque", "free"):
        off = np.array(sealed["factors"]["mass"]) - 1
        assert np.abs(off).max() <= TOLERANCES["mass"]
