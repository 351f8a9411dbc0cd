"""Simulated effects agree with independent equations, within a step and over whole motions.

The arms of the gap suite are integrated without MuJoCo, with laws of their own (a friction at rest
is a steep tangent there, a constraint here).
"""

from __future__ import annotations

import dataclasses
from typing import Any

import mujoco
import numpy as np
import pytest

pytest.importorskip("numba")


from loose_env.gap import Hypothesis
from loose_env.gap.model.effects.catalogue import CATALOGUE
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.output.corrected_model import corrected_spec, correction_code
from loose_env.gap.runs import Channel, Trial, align_run, channels_of
from loose_env.gap.simulator import Simulator
from loose_env.recording import Run
from loose_env.typing import Array
from scripts.suites.gap.arms import MACHINES, Machine, model_xml
from scripts.suites.gap.dynamics import Signals, exactly
from scripts.suites.gap.effects import KINDS
from scripts.suites.gap.effects import Effect as TrueEffect
from scripts.suites.gap.worlds import SAMPLE, Motion, Noise, Setup
from tests.gap.cases.effect_arms import PLANAR

COUNT = 1500
SHARED = {"share": 0.3, "static_ratio": 1.0, "speed": 0.1, "smooth_speed": 1e-3, "load_ratio": 0.0}
ASYMMETRIC = {"torque": 4.0, "static_ratio": 1.0, "speed": 0.1, "smooth_speed": 1e-3,
              "forward": 6.0, "backward": 2.0}  # fmt: skip
Case = tuple[str, str, str, dict[str, Any], str, list[float]]
CASES: list[Case] = [
    ("load_friction", "planar3", "joint1", SHARED, "", [0.3]),
    ("load_friction", "spatial3", "joint2", SHARED | {"share": 0.4, "static_ratio": 1.6,
     "speed": 0.2}, "stribeck", [0.4, 1.6, 0.2]),
    ("load_friction", "spatial3", "joint2", SHARED | {"speed": 0.2, "load_ratio": 0.5}, "external",
     [0.3, 0.15]),
    ("asymmetric_friction", "planar3", "joint2", ASYMMETRIC, "", [6.0, 2.0]),
    ("torque_limit", "planar3", "motor1", {"limit": 40.0}, "", [40.0]),
    ("voltage_limit", "planar3", "motor1", {"stall_torque": 60.0, "no_load_speed": 2.0}, "",
     [60.0, 2.0]),
    ("speed_limit", "planar3", "motor2", {"speed": 0.8}, "", [0.8]),
    ("dead_zone", "planar3", "motor2", {"width": 0.004}, "", [0.004]),
    ("gravity_compensation", "spatial3", "link2", {"share": -0.4}, "", [-0.4]),
    ("gear_eccentricity", "planar3", "joint2", {"sine": 0.01, "cosine": -0.004}, "",
     [0.01, -0.004]),
    ("sensor_quantisation", "planar3", "joint2_pos", {"step": 0.01}, "", [0.01]),
]  # fmt: skip
"""Kind, arm, location, parameters of the independent arm, variant, values of the catalogue."""
BASE = [
    ("base_compliance", "spatial3", "base", {"axis": axis, "stiffness": 4000.0,
     "damping_ratio": 0.3, "stiffening": 0.0}, axis, [4000.0, 0.3])
    for axis in ("y", "x")
]  # fmt: skip
NOTHING = Hypothesis()


def rms(difference: Array) -> Array:
    return np.asarray(np.sqrt(np.nanmean(difference**2, axis=0)))


class Compared:
    """A run of the independent arm, and the catalogue's effect on the nominal model."""

    def __init__(self, case: Case, *, lacking: bool = True) -> None:
        kind, name, where, parameters, variant, values = case
        nominal = MACHINES[name]
        place = next(p for p in KINDS[kind].places(nominal) if p.name == where)
        true = (TrueEffect(kind=kind, place=place, parameters=parameters),) if lacking else ()
        noise = Noise.draw(nominal, np.random.default_rng(0), SAMPLE)
        factors = exactly(nominal.joints)
        arm = Setup(machine=nominal, factors=factors, effects=true, noise=noise)
        self.commands = swing(nominal)
        signals = arm.run(Motion(commands=self.commands))
        spec = mujoco.MjSpec.from_string(model_xml(nominal))
        spec.option.timestep, spec.option.integrator = 5e-4, 1
        self.machine = NominalModel(spec)
        run = run_of(signals, self.commands)
        self.channels = channels_of([run])
        trial = align_run(run, self.machine, self.channels, step=5e-4)
        begin = signals.position[0]
        self.trial = dataclasses.replace(trial, position=begin, resting=True)
        effect = CATALOGUE[kind](self.machine, where, variant or None)
        self.hypothesis = Hypothesis(effects=(effect,), values=(np.array(values),))

    def simulated(self, hypothesis: Hypothesis) -> Array:
        simulator = Simulator(self.machine, [self.trial], self.channels, threads=1)
        return np.asarray(simulator.predict([hypothesis])[0][0])

    def off(self, shown: Array, expected: Array, visible: Array) -> float:
        """Error as a share of what is most visible of the effect."""
        error, seen = (rms((each - expected)[100:]) for each in (shown, visible))
        return float(np.linalg.norm(error / seen.max()))


def swing(machine: Machine) -> Array:
    """Commands that move every joint to and fro, from rest."""
    time = np.arange(COUNT) * 1e-3
    rates = np.array([0.9, 1.3, 1.9, 2.4])[: machine.joints]
    wave = np.sin(2 * np.pi * rates * time[:, None]) * np.minimum(time / 0.3, 1.0)[:, None] ** 2
    return np.asarray(machine.home + 0.4 * machine.reach * wave)


def run_of(signals: Signals, commands: Array) -> Run:
    """Positions and speeds under commands."""
    joints, time = range(commands.shape[1]), np.arange(COUNT) * 1e-3
    sensors = {f"joint{j + 1}_pos": signals.position[:, j] for j in joints}
    sensors |= {f"joint{j + 1}_vel": signals.velocity[:, j] for j in joints}
    controls = {f"motor{j + 1}": commands[:, j] for j in joints}
    return Run(name="run-1", time=time, controls=controls, sensors=sensors)


@pytest.mark.parametrize("case", [*CASES, *BASE], ids=lambda case: f"{case[0]}-{case[4]}")
def test_an_effect_moves_the_arm_as_its_independent_equations_do(case: Case) -> None:
    both = Compared(case)
    shown, without = both.simulated(both.hypothesis), both.simulated(NOTHING)
    # a base swings freely for the settling time before; damping is that of either inertia
    most = 0.2 if case in BASE else 0.06
    assert both.off(shown, both.trial.measured, without) < most


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case[0]}-{case[4]}")
def test_the_exported_model_and_its_code_reproduce_the_motion(case: Case) -> None:
    both = Compared(case, lacking=False)
    expected = both.simulated(both.hypothesis)
    spec = corrected_spec(both.machine, both.hypothesis, step=2.5e-4)
    model = mujoco.MjModel.from_xml_string(spec.to_xml())
    data = mujoco.MjData(model)
    data.qpos[:] = both.trial.position
    before, _, after = correction_code(both.hypothesis).partition("# after every mj_step")
    if not before.startswith("# before"):
        before, after = "", before
    lines = compile(before, "before", "exec"), compile(after, "after", "exec")
    names = {"model": model, "data": data}
    inside = round(1e-3 / model.opt.timestep)
    shown = np.zeros((COUNT, len(both.channels)))
    settling = np.tile(both.commands[0], (400, 1))
    for k, command in enumerate(np.vstack([settling, both.commands]), start=-400):
        for part in range(inside):
            data.ctrl[:] = command
            exec(lines[0], names)
            mujoco.mj_step(model, data)
            if part == 0 and k >= 0:
                exec(lines[1], names)
                for c, channel in enumerate(both.channels):
                    shown[k, c] = data.sensor(channel.column.removeprefix("sensor.")).data[0]
    assert both.off(shown, expected, both.trial.measured) < 0.06


GEARED = """
<mujoco>
  <option timestep="0.001" gravity="0 0 0"/>
  <worldbody>
    <body><joint name="shoulder" axis="0 1 0" damping="3"/><geom size=".1"/>
      <body pos="0 0 0.3"><joint name="elbow" axis="0 1 0" damping="3"/><geom size=".1"/></body>
    </body>
  </worldbody>
  <tendon>
    <fixed name="both"><joint joint="shoulder" coef="2"/><joint joint="elbow" coef="-1"/></fixed>
  </tendon>
  <actuator>
    <motor name="coupled" tendon="both" gear="3"/>
    <motor name="outer" jointinparent="shoulder" gear="5"/>
  </actuator>
  <sensor><jointpos name="encoder" joint="shoulder"/></sensor>
</mujoco>
"""


def geared_trial() -> Trial:
    time = np.arange(200) * 0.001
    controls = np.sin(np.outer(time, [9.0, 13.0]))
    return Trial(
        name="run", form="forward", time=time, measured=np.zeros((200, 2)), step=0.001, steps=200,
        controls=controls, before=controls[:0], position=np.zeros(2), speed=np.zeros(2),
        resting=False,
    )  # fmt: skip


def test_forces_of_tendons_count_as_torque_on_the_joints_they_pull() -> None:
    machine = NominalModel(mujoco.MjSpec.from_string(GEARED))
    assert machine.actuated_joint == {"outer": "shoulder"}
    trial = geared_trial()
    channels = tuple(Channel(f"torque.{name}") for name in ("shoulder", "elbow"))
    found = Simulator(machine, [trial], channels, threads=1).predict([NOTHING])[0][0]
    data = mujoco.MjData(machine.model)
    for k in range(200):
        data.ctrl[:] = trial.controls[k]
        mujoco.mj_forward(machine.model, data)
        assert np.allclose(found[k], data.qfrc_actuator)
        mujoco.mj_step(machine.model, data)


def test_a_delay_of_the_model_stays_at_a_finer_step() -> None:
    late = '<position name="servo2" delay="0.01" nsample="12"'
    spec = mujoco.MjSpec.from_string(PLANAR.replace('<position name="servo2"', late))
    machine = NominalModel(spec)
    model = NOTHING.model(machine, 0.000125)
    data, shown = mujoco.MjData(model), []
    for _ in range(100):
        data.ctrl[1] = 1.0
        mujoco.mj_step(model, data)
        shown.append(abs(data.actuator_force[1]) > 100.0)
    assert shown.index(True) == pytest.approx(80, abs=1)
    assert corrected_spec(machine, NOTHING, step=0.00025).actuators[1].nsample >= 40


def test_a_late_drive_follows_the_commands_before_a_window() -> None:
    machine, whole = NominalModel(mujoco.MjSpec.from_string(GEARED)), geared_trial()
    late = Hypothesis(
        effects=(CATALOGUE["command_delay"](machine, "all"),), values=(np.array([0.03]),)
    )
    channels = tuple(Channel(f"torque.{name}") for name in ("shoulder", "elbow"))
    simulator = Simulator(machine, [whole, whole.between(100, 180)], channels, threads=1)
    found, part = simulator.predict([late])[0]
    assert np.allclose(part, found[100:180], atol=1e-9) and np.ptp(part[:, 0]) > 0.1
