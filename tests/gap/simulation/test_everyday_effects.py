"""Effects that everyday machines have: what the catalogue does agrees with independent equations.

The arms of the gap suite are integrated without MuJoCo, with laws of their own (a friction at rest
is a steep tangent there, a constraint here).
"""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest

pytest.importorskip("numba")

from loose_env.gap.data.aligned_run import Trial, align_run, channels_of
from loose_env.gap.model.effects.catalogue import CATALOGUE
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.output.export_mjcf import corrected_spec, correction_code
from loose_env.gap.simulation.inverse_dynamics import InverseDynamics
from loose_env.gap.simulation.simulator import Simulator
from loose_env.recording import Run
from loose_env.typing import Array
from scripts.suites.gap.arms import ARMS, Figures, model_xml
from scripts.suites.gap.dynamics import Factors
from scripts.suites.gap.effects import KINDS
from scripts.suites.gap.effects import Effect as TrueEffect
from scripts.suites.gap.machine import Motion, Signals, TrueArm

STEP = 5e-4
COUNT = 1500
CASES = [
    ("load_friction", "planar3", "joint1", {"share": 0.3, "static_ratio": 1.0, "speed": 0.1,
     "smooth_speed": 1e-3, "load_ratio": 0.0}, "", [0.3]),
    ("load_friction", "spatial3", "joint2", {"share": 0.4, "static_ratio": 1.6, "speed": 0.2,
     "smooth_speed": 1e-3, "load_ratio": 0.0}, "stribeck", [0.4, 1.6, 0.2]),
    ("load_friction", "spatial3", "joint2", {"share": 0.3, "static_ratio": 1.0, "speed": 0.2,
     "smooth_speed": 1e-3, "load_ratio": 0.5}, "external", [0.3, 0.15]),
    ("asymmetric_friction", "planar3", "joint2", {"torque": 4.0, "static_torque": 4.0,
     "speed": 0.1, "smooth_speed": 1e-3, "forward": 6.0, "backward": 2.0}, "", [6.0, 2.0]),
    ("torque_limit", "planar3", "motor1", {"limit": 40.0}, "", [40.0]),
    ("voltage_limit", "planar3", "motor1", {"stall_torque": 60.0, "back_emf": 30.0}, "",
     [60.0, 2.0]),
    ("dead_zone", "planar3", "motor2", {"width": 0.004}, "", [0.004]),
    ("gravity_compensation", "spatial3", "link2", {"share": -0.4}, "", [-0.4]),
    ("gear_eccentricity", "planar3", "joint2", {"sine": 0.01, "cosine": -0.004}, "",
     [0.01, -0.004]),
    ("sensor_quantisation", "planar3", "joint2_pos", {"step": 0.01}, "", [0.01]),
]  # fmt: skip
"""Kind, arm, location, parameters of the independent arm, variant, values of the catalogue."""
STIFFNESS, RATIO = 4000.0, 0.3


def swing(figures: Figures) -> Array:
    """Commands that move every joint to and fro, from rest."""
    time = np.arange(COUNT) * 1e-3
    rates = np.array([0.9, 1.3, 1.9, 2.4])[: figures.joints]
    wave = np.sin(2 * np.pi * rates * time[:, None]) * np.minimum(time / 0.3, 1.0)[:, None] ** 2
    return np.asarray(figures.home + 0.4 * figures.reach * wave)


def signals_of(figures: Figures, *effects: TrueEffect) -> tuple[Signals, Array]:
    arm = TrueArm(figures=figures, factors=Factors.ones(figures.joints), effects=effects)
    commands = swing(figures)
    return arm.run(Motion(commands=commands)), commands


def true_effect(kind: str, figures: Figures, where: str, parameters: dict) -> TrueEffect:
    place = next(p for p in KINDS[kind].places(figures) if p.name == where)
    return TrueEffect(kind=kind, place=place, parameters=parameters)


def run_of(signals: Signals, commands: Array) -> Run:
    joints = range(commands.shape[1])
    return Run(
        name="run-1",
        time=np.arange(COUNT) * 1e-3,
        controls={f"motor{j + 1}": commands[:, j] for j in joints},
        sensors={
            **{f"joint{j + 1}_pos": signals.position[:, j] for j in joints},
            **{f"joint{j + 1}_vel": signals.velocity[:, j] for j in joints},
        },
    )


def machine_of(figures: Figures) -> NominalModel:
    return NominalModel(mujoco.MjSpec.from_string(model_xml(figures)), step=STEP, integrator=1)


def resting(trial: Trial) -> Trial:
    """The run, begun at rest: readings without noise do not tell."""
    return dataclasses.replace(trial, resting=True)


def error(shown: Array, expected: Array) -> Array:
    return np.asarray(np.sqrt(np.mean((shown[100:] - expected[100:]) ** 2, axis=0)))


@pytest.mark.parametrize(("kind", "name", "where", "parameters", "variant", "values"), CASES)
def test_an_effect_moves_the_arm_as_its_independent_equations_do(
    kind, name, where, parameters, variant, values
):
    figures = ARMS[name]()
    signals, commands = signals_of(figures, true_effect(kind, figures, where, parameters))
    machine, run = machine_of(figures), run_of(signals, commands)
    channels = channels_of([run])
    trial = resting(align_run(run, machine, channels, step=STEP))
    effect = CATALOGUE[kind](machine, where, variant or None)
    hypothesis = Hypothesis(effects=(effect,), values=(np.array(values),))
    simulator = Simulator(machine, [trial], channels, threads=1)
    (shown,), (without,) = simulator.predict([hypothesis, Hypothesis()])
    off, visible = (error(each, trial.measured) for each in (shown, without))
    assert np.linalg.norm(off / visible.max()) < 0.06, (off / visible).round(3)


def test_a_base_on_a_spring_rocks_as_the_independent_one():
    for name, axis in (("spatial3", "y"), ("spatial3", "x")):
        figures = ARMS[name]()
        parameters = {
            "axis": axis, "stiffness": STIFFNESS, "damping_ratio": RATIO, "stiffening": 0.0
        }  # fmt: skip
        true = true_effect("base_compliance", figures, "base", parameters)
        signals, commands = signals_of(figures, true)
        machine, run = machine_of(figures), run_of(signals, commands)
        channels = channels_of([run])
        trial = resting(align_run(run, machine, channels, step=STEP))
        effect = CATALOGUE["base_compliance"](machine, "base", axis)
        hypothesis = Hypothesis(effects=(effect,), values=(np.array([STIFFNESS, RATIO]),))
        simulator = Simulator(machine, [trial], channels, threads=1)
        (shown,), (without,) = simulator.predict([hypothesis, Hypothesis()])
        off, visible = (error(each, trial.measured) for each in (shown, without))
        # the base swings freely for the settling time before; damping is that of either inertia
        assert np.linalg.norm(off / visible.max()) < 0.2, (name, (off / visible).round(3))


@pytest.mark.parametrize(("kind", "name", "where", "parameters", "variant", "values"), CASES)
def test_the_exported_model_and_its_code_reproduce_the_motion(
    kind, name, where, parameters, variant, values
):
    figures = ARMS[name]()
    machine, commands = machine_of(figures), swing(figures)
    effect = CATALOGUE[kind](machine, where, variant or None)
    hypothesis = Hypothesis(effects=(effect,), values=(np.array(values),))
    blank, _ = signals_of(figures)
    run = run_of(blank, commands)
    channels = channels_of([run])
    trial = resting(align_run(run, machine, channels, step=STEP))
    expected = Simulator(machine, [trial], channels, threads=1).predict([hypothesis])[0][0]

    model = mujoco.MjModel.from_xml_string(
        corrected_spec(machine, hypothesis, step=2.5e-4).to_xml()
    )
    data = mujoco.MjData(model)
    data.qpos[:] = trial.position
    before, _, after = correction_code(hypothesis).partition("# after every mj_step")
    if not before.startswith("# before"):
        before, after = "", before
    lines = compile(before, "before", "exec"), compile(after, "after", "exec")
    inside = round(1e-3 / model.opt.timestep)
    shown = np.zeros((COUNT, len(channels)))

    def step(command: Array) -> None:
        data.ctrl[:] = command
        exec(lines[0], {"model": model, "data": data})
        mujoco.mj_step(model, data)

    for _ in range(400 * inside):
        step(commands[0])
    for k in range(COUNT):
        for part in range(inside):
            step(commands[k])
            if part == 0:
                exec(lines[1], {"model": model, "data": data})
                for c, channel in enumerate(channels):
                    shown[k, c] = data.sensor(channel.column.removeprefix("sensor.")).data[0]
    off, visible = error(shown, expected), error(trial.measured, expected)
    assert np.linalg.norm(off / visible.max()) < 0.06, (off / visible).round(3)


def test_a_measured_torque_with_a_wrong_constant_is_scaled():
    figures = ARMS["planar3"]()
    machine = machine_of(figures)
    effect = CATALOGUE["torque_constant"](machine, "joint2")
    torque = np.array([1.0, -2.0])
    assert np.allclose(effect.sensed_torque("joint2", torque, np.array([0.8])), [0.8, -1.6])
    assert np.allclose(effect.sensed_torque("joint1", torque, np.array([0.8])), torque)
    shown = effect.read(np.zeros(2), {"torque.joint2": torque}, np.array([0.8]))
    assert np.allclose(shown["torque.joint2"], [0.8, -1.6])


@pytest.mark.parametrize(
    ("kind", "where", "parameters", "variant", "values"),
    [
        ("load_friction", "joint1", {"share": 0.3, "static_ratio": 1.0, "speed": 0.1,
         "smooth_speed": 1e-3, "load_ratio": 0.0}, "", [0.3]),
        ("load_friction", "joint1", {"share": 0.3, "static_ratio": 1.0, "speed": 0.1,
         "smooth_speed": 1e-3, "load_ratio": 0.6}, "external", [0.3, 0.18]),
        ("asymmetric_friction", "joint2", {"torque": 4.0, "static_torque": 4.0, "speed": 0.1,
         "smooth_speed": 1e-3, "forward": 6.0, "backward": 2.0}, "", [6.0, 2.0]),
        ("torque_constant", "joint2", {"factor": 0.8}, "", [0.8]),
        ("gravity_compensation", "link2", {"share": -0.4}, "", [-0.4]),
    ],
)  # fmt: skip
def test_an_effect_is_seen_in_measured_torques(kind, where, parameters, variant, values):
    figures = ARMS["planar3"]()
    true = true_effect(kind, figures, where, parameters)
    arm = TrueArm(figures=figures, factors=Factors.ones(3), effects=(true,))
    commands = swing(figures)
    signals = arm.run(Motion(commands=commands, straight=True))
    rng = np.random.default_rng(1)
    joints = range(3)
    run = Run(
        name="run-1",
        time=np.arange(COUNT) * 1e-3,
        sensors={
            f"joint{j + 1}_pos": signals.position[:, j] + 1e-5 * rng.normal(size=COUNT)
            for j in joints
        },
        torques={
            f"joint{j + 1}": signals.torque[:, j] + 0.05 * rng.normal(size=COUNT) for j in joints
        },
    )
    machine = machine_of(figures)
    channels = channels_of([run])
    inverse = InverseDynamics(
        machine, [align_run(run, machine, channels, step=1e-3)], channels, threads=1
    )
    effect = CATALOGUE[kind](machine, where, variant or None)
    assert inverse.shows(effect)
    known = Hypothesis(effects=(effect,), values=(np.array(values),))
    measured = inverse.measured(0)
    (shown,), (without,) = inverse.predict([known, Hypothesis()])
    torques = [k for k, channel in enumerate(channels) if channel.column.startswith("torque")]
    off, visible = (
        np.sqrt(np.nanmean((e - measured)[:, torques] ** 2, axis=0)) for e in (shown, without)
    )
    own = int(np.argmax(visible))
    assert off[own] < 0.25 * visible[own], (off, visible)
