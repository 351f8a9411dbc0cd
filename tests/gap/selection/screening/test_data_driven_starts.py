"""What torque the drives gave beyond the model's, and what looks for itself in it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from loose_env.gap.data.actuator_states import activations
from loose_env.gap.data.aligned_run import Channel, Trial, align_run, channels_of
from loose_env.gap.diagnostics.joint_torque_residual import joint_motion
from loose_env.gap.diagnostics.localisation import locate
from loose_env.gap.model.effects.catalogue import CATALOGUE
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.residuals.preparation.prepare import prepare
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.gap.selection.screening.data_driven_starts import proposals, residual_torque
from loose_env.gap.settings import GapSettings
from loose_env.gap.simulation.simulator import Simulator
from loose_env.recording import Recording, Run, write_recording
from tests.gap.cases.effect_arms import PLANAR
from tests.gap.cases.gap_case import DAMPING, MODEL, STEP, record

SERVO = (
    '<general name="servo2" joint="joint2" gainprm="1000" biastype="affine" '
    'biasprm="0 -1000 -40" dyntype="{}"/>'
)
NOTHING = Hypothesis()


def compared(recording: Recording) -> ResidualModel:
    machine = NominalModel(recording.spec(), step=STEP)
    channels = channels_of(list(recording.runs))
    trials = [align_run(run, machine, channels, step=STEP) for run in recording.runs]
    return ResidualModel(machine, trials, channels, np.ones(len(channels)), threads=1)


def test_the_missing_torque_is_what_the_model_lacks(tmp_path: Path) -> None:
    found = residual_torque(compared(record(tmp_path / "r")), NOTHING)
    assert found is not None
    _, speed, _, torque, _ = found
    moving = np.abs(speed[:, 1]) > 0.2
    rate = np.sum(torque[moving, 1] * speed[moving, 1]) / np.sum(speed[moving, 1] ** 2)
    assert rate == pytest.approx(DAMPING, rel=0.1)
    # Nothing is missing at the first joint, but for what the noise makes of it.
    assert np.std(torque[:, 0]) < 0.2 * np.std(torque[:, 1])


def test_what_is_known_already_is_taken_off(tmp_path: Path) -> None:
    comparison = compared(record(tmp_path / "r"))
    friction = CATALOGUE["viscous_friction"](comparison.machine, "joint2")
    known = Hypothesis(effects=(friction,), values=(np.array([DAMPING]),))
    before, after = residual_torque(comparison, NOTHING), residual_torque(comparison, known)
    assert before is not None and after is not None
    assert np.std(after[3][:, 1]) < 0.3 * np.std(before[3][:, 1])


@pytest.mark.parametrize("periods", [7.0, 13.0])
def test_a_ripple_finds_its_own_period(tmp_path: Path, periods: float) -> None:
    comparison = compared(record(tmp_path / "r", runs=2))
    machine = comparison.machine
    ripple = CATALOGUE["torque_ripple"](machine, "joint1")
    spec = mujoco.MjSpec.from_string(MODEL)
    ripple.edit(spec, np.array([4.0, periods, 0.8]))
    model, trials = spec.compile(), []
    for trial in comparison.trials:
        data = mujoco.MjData(model)
        shown = np.zeros_like(trial.measured)
        for k, row in enumerate(shown):
            data.ctrl[:3] = trial.controls[k]
            mujoco.mj_step(model, data)
            row[:] = data.sensordata
        motion = {f"joint{j + 1}": shown[:, j] for j in range(3)}
        trials.append(replace(trial, measured=shown, motion=motion))
    comparison = ResidualModel(machine, trials, comparison.channels, comparison.floors, threads=1)
    starts = proposals(comparison, NOTHING, [ripple])[ripple.key]
    nearest = min(starts, key=lambda start: abs(start[1] - periods))
    assert nearest[1] == pytest.approx(periods, abs=1.0)
    assert nearest[0] == pytest.approx(4.0, rel=0.35)


SLOW = 'kp="1000" kv="40" ctrlrange="-2 2"'


def slowed(folder: Path, dynamics: str) -> Recording:
    """A recording of an arm that is its model: the second servo has dynamics of its own."""
    xml = MODEL.replace(f'<position name="servo2" joint="joint2" {SLOW}/>', SERVO.format(dynamics))
    assert xml != MODEL
    model, rng = mujoco.MjModel.from_xml_string(xml), np.random.default_rng(4)
    time, runs = np.arange(1000) * STEP, []
    for number in range(2):
        data = mujoco.MjData(model)
        controls = 0.4 * np.sin(np.outer(time, [2.0 + number, 4.0, 6.0 - number]))
        controls *= np.minimum(2 * time, 1.0)[:, None]
        shown = np.zeros((len(time), 3))
        for row, command in zip(shown, controls, strict=True):
            row[:] = data.qpos
            data.ctrl[:] = command
            mujoco.mj_step(model, data)
        shown += rng.normal(0, 1e-5, shown.shape)
        commands = {f"servo{j + 1}": controls[:, j] for j in range(3)}
        sensors = {f"encoder{j + 1}": shown[:, j] for j in range(3)}
        name = f"run-{number}.csv"
        runs.append(Run(name=name, time=time, controls=commands, sensors=sensors))
    return write_recording(folder, model_xml=xml, runs=runs, file_format="csv")


@pytest.mark.parametrize("dynamics", ['filter" dynprm="0.05', 'filterexact" dynprm="0.05'])
def test_no_torque_is_missing_behind_a_filter_that_the_model_has(
    dynamics: str, tmp_path: Path
) -> None:
    comparison = compared(slowed(tmp_path / "r", dynamics))
    found = residual_torque(comparison, NOTHING)
    assert found is not None
    trial = comparison.trials[0]
    motion = joint_motion(comparison.machine, trial, comparison.channels, comparison.floors)
    for missing in (found[3][:, 1], motion.residual_torque[:, 1]):
        assert np.nanstd(missing) < 0.05 * np.nanstd(motion.load[:, 1])
    assert np.nanstd(motion.load[:, 1]) > 5.0


@pytest.mark.parametrize("dynamics", ["integrator", 'muscle" dynprm="0.01 0.04'])
def test_what_an_actuator_of_unknown_state_gave_is_not_known(dynamics: str, tmp_path: Path) -> None:
    comparison = compared(slowed(tmp_path / "r", dynamics))
    ripple = CATALOGUE["torque_ripple"](comparison.machine, "joint1")
    assert residual_torque(comparison, NOTHING) is None
    assert proposals(comparison, NOTHING, [ripple]) == {}
    assert ripple.starts
    trial = comparison.trials[0]
    motion = joint_motion(comparison.machine, trial, comparison.channels, comparison.floors)
    assert np.isnan(motion.residual_torque).all() and np.isfinite(motion.load).all()
    rows = comparison.rows
    residual = np.random.default_rng(1).normal(size=len(comparison))
    one = np.flatnonzero(rows.trial == 0)
    assert len(one) and not locate(
        residual, rows, comparison.trials, comparison.channels,
        [joint_motion(comparison.machine, t, comparison.channels, comparison.floors)
         for t in comparison.trials],
    ).joints  # fmt: skip


@pytest.mark.parametrize("integrator", ["Euler", "RK4"])
@pytest.mark.parametrize("limits", ["", 'actlimited="true" actrange="-0.2 0.3"'])
@pytest.mark.parametrize("filter", ["filter", "filterexact"])
def test_activations_are_those_of_the_simulation(integrator: str, limits: str, filter: str) -> None:
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option timestep="0.002" integrator="{integrator}"/>
        <worldbody><body><joint name="j"/><geom size="0.1"/></body></worldbody>
        <actuator>
          <motor joint="j"/>
          <general joint="j" dyntype="{filter}" dynprm="0.03" ctrlrange="-0.5 0.5" {limits}/>
        </actuator></mujoco>"""
    )
    controls = np.random.default_rng(2).uniform(-1, 1, (200, 2)).repeat(5, axis=0)
    controls[0] = 0.0
    data, shown = mujoco.MjData(model), []
    for command in controls:
        shown.append(data.act[0])
        data.ctrl[:] = command
        mujoco.mj_step(model, data)
    found = activations(model, controls, 0.002)
    held = np.array(shown[:-1])
    if integrator == "RK4":  # it moves within a step
        held = (held + np.array(shown[1:])) / 2
    assert found is not None and found[:-1, 0] == pytest.approx(held, abs=1e-6)


def test_effects_that_do_not_search_are_left_to_their_own_starts(tmp_path: Path) -> None:
    comparison = compared(record(tmp_path / "r", runs=2))
    friction = CATALOGUE["viscous_friction"](comparison.machine, "joint2")
    assert proposals(comparison, NOTHING, [friction]) == {}


@pytest.mark.parametrize(("where", "angle"), [("link1", 0.4), ("link2", 1.9), ("link3", -0.8)])
def test_a_loose_link_shakes_the_tool_along_its_own_direction(where: str, angle: float) -> None:
    runge_kutta = int(mujoco.mjtIntegrator.mjINT_RK4)
    machine = NominalModel(mujoco.MjSpec.from_string(PLANAR), step=0.001, integrator=runge_kutta)
    channels = (
        *(Channel(f"sensor.encoder{k}") for k in (1, 2, 3)),
        *(Channel("sensor.shake", axis) for axis in range(3)),
    )
    count = 3000
    time = np.arange(count) * 0.001
    waves = np.sin(np.outer(time, [6.0, 9.0, 13.0]))
    bare = Trial(
        name="run-01.csv", form="forward", time=time, measured=np.zeros((count, 6)), step=0.001,
        steps=count, controls=waves * np.minimum(time, 1)[:, None],
        position=np.zeros(3), speed=np.zeros(3), resting=True, joints=machine.joints,
    )  # fmt: skip
    effect = CATALOGUE["structural_looseness"](machine, where)
    values = np.array([angle, 2e-4, *effect.starts[0][2:]])
    loose = Hypothesis(effects=(effect,), values=(values,))
    shown = Simulator(machine, [bare], channels, threads=1).predict([loose])[0][0]
    trial = replace(bare, measured=shown, motion={f"joint{k + 1}": shown[:, k] for k in range(3)})
    floors = np.array([1e-5] * 3 + [0.02] * 3)
    comparison = ResidualModel(machine, [trial], channels, floors, threads=1)
    starts = proposals(comparison, NOTHING, [effect])[effect.key]
    off = min(abs((start[0] - angle + np.pi / 2) % np.pi - np.pi / 2) for start in starts)
    assert off < 0.3  # a fit gets on from there
    gaps = {start[1] for start in starts}
    assert min(gaps) < 2e-4 < max(gaps)


def test_without_a_limit_the_start_is_the_largest_torque_given(tmp_path: Path) -> None:
    comparison = compared(record(tmp_path / "r"))
    limit = CATALOGUE["torque_limit"](comparison.machine, comparison.machine.actuators[1])
    ((start,),) = proposals(comparison, NOTHING, [limit])[limit.key]
    found = residual_torque(comparison, NOTHING)
    assert found is not None
    needed = np.abs(found[4][:, 1])
    assert 0.8 * needed.max() < start <= needed.max() and start > 2 * np.median(needed)


@pytest.mark.parametrize(
    ("kind", "values"), [("torque_limit", (21.0,)), ("voltage_limit", (40.0, 9.0))]
)
def test_a_limit_starts_where_it_explains_what_was_not_given(
    kind: str, values: tuple[float, ...]
) -> None:
    machine = NominalModel(mujoco.MjSpec.from_string(PLANAR), step=0.001)
    rng, time = np.random.default_rng(5), np.linspace(0.0, 10.0, 3000)
    speed = 3.0 * np.cos(4.0 * time) + np.cos(9.0 * time)
    asked = 50.0 * np.sin(2.3 * time + 0.4) * np.cos(0.7 * time)
    stall = values[0]
    back = stall / values[1] * speed if len(values) > 1 else 0.0
    given = np.clip(asked + back, -stall, stall) - back + rng.normal(0.0, 0.5, len(time))
    given[::40] += rng.normal(0.0, 30.0, len(given[::40]))  # where smoothing went wrong
    limit = CATALOGUE[kind](machine, "servo1")
    (start,) = limit.propose_limit(speed, asked, given)
    assert start == pytest.approx(values, rel=0.25 if len(values) > 1 else 0.03)


def test_a_ripple_in_measured_torques_finds_its_own_period(tmp_path: Path) -> None:
    model = mujoco.MjModel.from_xml_string(PLANAR)
    data, rng = mujoco.MjData(model), np.random.default_rng(4)
    time = np.arange(2000) * 0.002
    rate = 2 * np.pi * np.array([0.4, 0.55, 0.7])
    runs = []
    for k in range(2):
        phase = rng.uniform(-np.pi, np.pi, 3)
        position = np.sin(np.outer(time, rate) + phase)
        speed = rate * np.cos(np.outer(time, rate) + phase)
        torques = np.zeros_like(position)
        for row, q, v, a in zip(torques, position, speed, -(rate**2) * position, strict=True):
            data.qpos[:3], data.qvel[:3], data.qacc[:3] = q, v, a
            mujoco.mj_inverse(model, data)
            row[:] = data.qfrc_inverse[:3]
        torques[:, 0] += 3.0 * np.sin(17.0 * position[:, 0] + 0.4)
        torques += rng.normal(0.0, 0.05, torques.shape)
        readings = position + rng.normal(0.0, 1e-5, position.shape)
        runs.append(
            Run(
                name=f"run-{k}.csv",
                time=time,
                torques={f"joint{j + 1}": torques[:, j] for j in range(3)},
                sensors={f"encoder{j + 1}": readings[:, j] for j in range(3)},
            )
        )
    recording = write_recording(tmp_path / "r", model_xml=PLANAR, runs=runs)
    comparison = prepare(recording, GapSettings(threads=1, kinds=("torque_ripple",))).search
    ripple = CATALOGUE["torque_ripple"](comparison.machine, "joint1")
    starts = proposals(comparison, NOTHING, [ripple])[ripple.key]
    # what is compared is smoothed as the motion is: the start is too low rather than too high
    assert 1.0 < starts[0][0] < 3.3
    assert starts[0][1] == pytest.approx(17.0, abs=0.5)
