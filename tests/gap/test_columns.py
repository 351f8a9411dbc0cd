"""Columns of effects explain what the simulated effect leaves in the force balance.

Each effect is put into a servo arm by the simulator, with no other error and no noise; its column
at the true value should then be the residual, beyond that of the arm without the effect.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest

from loose_env.gap import Hypothesis
from loose_env.gap.core.balance import CONTACTS, USUAL, Balance
from loose_env.gap.core.evidence import grid_of, noise_beside
from loose_env.gap.core.motion import low_passed, rates, smooth
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.effects.catalogue import CATALOGUE, EFFECTS
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.runs import align_run, channels_of
from loose_env.gap.simulator import Simulator
from loose_env.recording import Recording, Run
from loose_env.typing import Array

ARM = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.0005" integrator="RK4"/>
  <default><joint axis="0 1 0" armature="0.08" damping="0.6"/></default>
  <worldbody>
    <body name="column" pos="0 0 0.2">
      <joint name="turn" axis="0 0 1"/>
      <inertial pos="0.02 0 0.05" mass="3" diaginertia="0.02 0.02 0.02"/>
      <body name="upper" pos="0 0 0.1">
        <joint name="lift"/>
        <inertial pos="0.16 0 0.01" mass="2" diaginertia="0.004 0.02 0.02"/>
        <body name="lower" pos="0.3 0 0">
          <joint name="bend" armature="0.04"/>
          <inertial pos="0.12 0.01 0" mass="1.2" diaginertia="0.002 0.008 0.008"/>
          <site name="tool" pos="0.25 0 0"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="motor1" joint="turn" kp="300" kv="14" forcerange="-80 80"/>
    <position name="motor2" joint="lift" kp="400" kv="16" forcerange="-80 80"/>
    <position name="motor3" joint="bend" kp="150" kv="6" forcerange="-40 40"/>
  </actuator>
  <sensor>
    <jointpos name="encoder1" joint="turn"/>
    <jointpos name="encoder2" joint="lift"/>
    <jointpos name="encoder3" joint="bend"/>
    <jointvel name="rate3" joint="bend"/>
    <gyro name="spin" site="tool"/>
    <accelerometer name="shake" site="tool"/>
  </sensor>
</mujoco>
"""
STEP, COUNT, END_S, INSIDE = 5e-4, 8000, 0.4, 2
ENCODERS = ("encoder1", "encoder2", "encoder3")
OTHERS = {"rate3": (), "spin": (3,), "shake": (3,)}

Case = tuple[str, str, str, list[float]]
DRIVES: list[Case] = [
    ("actuator_gain", "motor2", "", [1.2]),
    ("actuator_gain", "motor2", "command", [1.05]),
    ("actuator_gain", "motor2", "servo", [0.6]),
    ("actuator_lag", "motor2", "", [0.01]),
    ("command_delay", "motor2", "", [0.007]),
    ("command_delay", "all", "", [0.007]),
    ("command_interpolation", "all", "", [1.0]),
    ("torque_limit", "motor2", "", [9.0]),
    ("voltage_limit", "motor2", "", [14.0, 5.0]),
    ("speed_limit", "motor2", "", [1.0]),
    ("dead_zone", "motor2", "", [0.006]),
]
"""Effects that a torque log does not show."""
FEW: list[Case] = [
    ("gear_eccentricity", "lift", "", [0.01, -0.004]),
    ("load_friction", "lift", "", [0.2]),
    ("link_flexibility", "upper", "across", [800.0, 0.1, 0.5]),
    ("sensor_gain", "encoder2", "", [1.05]),
]
"""Those that are checked in every test run."""
ALL: list[Case] = [
    ("viscous_friction", "lift", "", [2.0]),
    ("coulomb_friction", "lift", "", [1.5]),
    ("stribeck_friction", "lift", "", [1.5, 1.6, 0.3]),
    ("quadratic_drag", "lift", "", [1.0]),
    ("asymmetric_friction", "lift", "", [2.0, 0.8]),
    ("load_friction", "bend", "stribeck", [0.2, 1.6, 0.3]),
    ("load_friction", "lift", "external", [0.2, 0.15]),
    ("joint_compliance", "lift", "", [800.0, 0.1]),
    ("link_flexibility", "upper", "", [800.0, 0.1, 0.5]),
    ("base_compliance", "base", "x", [3000.0, 0.1]),
    ("base_compliance", "base", "y", [3000.0, 0.1]),
    ("link_mass", "upper", "", [0.6]),
    ("link_com", "upper", "", [0.03, 0.01, -0.02]),
    ("payload", "tool", "", [0.5]),
    ("payload", "tool", "centre", [0.5, 0.05, 0.02, -0.03]),
    ("base_tilt", "base", "", [0.04, -0.03]),
    ("gravity_compensation", "upper", "", [-0.4]),
    ("gravity_compensation", "all", "", [0.4]),
    ("rotor_inertia", "lift", "", [0.05]),
    ("torque_ripple", "lift", "", [1.5, 12.0, 0.5]),
    ("joint_spring", "lift", "", [6.0, 0.3]),
    ("torque_offset", "lift", "", [1.5]),
    ("encoder_offset", "lift", "", [0.02]),
    ("torque_constant", "lift", "", [1.2]),
    ("sensor_gain", "rate3", "", [1.1]),
    ("sensor_gain", "shake", "", [1.1]),
    ("sensor_bias", "rate3", "", [0.1]),
    ("sensor_bias", "encoder2", "", [0.02]),
    ("sensor_bias", "shake", "", [0.3, -0.2, 0.2]),
    ("sensor_delay", "encoder2", "", [0.006]),
    ("sensor_delay", "shake", "", [0.006]),
    ("sensor_delay", "spin", "", [0.006]),
    ("sensor_delay", "rate3", "", [0.006]),
    ("sensor_misalignment", "shake", "", [0.05, -0.03, 0.04]),
    ("sensor_misalignment", "spin", "", [0.05, -0.03, 0.04]),
    ("sensor_quantisation", "rate3", "", [0.1]),
]
LEAST = {
    "stribeck_friction": 0.97,
    "sensor_quantisation": 0.5,
    ("sensor_delay", "rate3"): 0.93,
}
"""Least share of the residual's power where it is below 0.98: at rest a friction is what balances,
rounding is as fine as the motion is known, and a late speed is part of the estimated motion."""
NOT_HERE = {"backlash", "structural_looseness", "friction_behind_slack"}
"""Stops have no column, and a path's memory is not simulated."""


@cache
def machine() -> NominalModel:
    return NominalModel(mujoco.MjSpec.from_string(ARM))


def commands() -> Array:
    """Three sines a joint that begin at rest."""
    time = np.arange(COUNT) * STEP
    rates = np.array([[0.35, 0.85, 1.9], [0.45, 1.1, 2.3], [0.6, 1.4, 2.9]])
    sizes = np.array([[0.5, 0.2, 0.05], [0.45, 0.18, 0.05], [0.5, 0.2, 0.05]])
    phases = np.arange(9).reshape(3, 3)
    wave = (sizes * np.sin(2 * np.pi * rates * time[:, None, None] + phases)).sum(axis=2)
    return np.array([0.2, -0.6, 0.9]) + wave * np.minimum(time / 0.5, 1.0)[:, None] ** 2


def recorded(effect: Effect | None, values: Array, form: str) -> Run:
    """Simulated run of the arm; a torque log is read in the middle of the held commands."""
    given, log = commands(), form == "inverse"
    # an accelerometer that is read as a command steps shows its jump, which no column has
    others = {n: s for n, s in OTHERS.items() if log or n != "shake"}
    run = Run(
        name=f"{effect!r}", time=np.arange(COUNT) * STEP,
        controls={f"motor{k + 1}": given[:, k] for k in range(3)},
        sensors=dict.fromkeys(ENCODERS, np.zeros(COUNT))
        | {name: np.zeros((COUNT, *shape)) for name, shape in others.items()},
        torques=dict.fromkeys(machine().joints, np.zeros(COUNT)) if log else {},
    )  # fmt: skip
    channels = channels_of([run])
    trial = align_run(run, machine(), channels, step=STEP / INSIDE if log else STEP)
    late = INSIDE // 2 if log else 0
    controls = np.concatenate([trial.controls[:1]] * late + [trial.controls])[: trial.steps]
    trial = replace(trial, controls=controls, position=given[0], resting=True)
    pairs = [] if effect is None else [(effect, values)]
    hypothesis = Hypothesis().with_effects(pairs)
    shown = Simulator(machine(), [trial], channels, threads=1).predict([hypothesis])[0][0]
    columns: dict[str, list[Array]] = {}
    for channel, column in zip(channels, shown.T, strict=True):
        columns.setdefault(channel.column, []).append(column)
    read = {n: v[0] if len(v) == 1 else np.stack(v, axis=1) for n, v in columns.items()}
    of = {p: {n.removeprefix(p): v for n, v in read.items() if n.startswith(p)}
          for p in ("sensor.", "torque.")}  # fmt: skip
    return replace(
        run, controls={} if log else run.controls, sensors=of["sensor."], torques=of["torque."]
    )


@cache
def plain(form: str) -> Run:
    """The arm without any effect."""
    return recorded(None, np.empty(0), form)


def explained(case: Case, form: str) -> float:
    """Share of the residual's power that the column at the true value explains."""
    kind, where, variant, true = case
    effect, values = EFFECTS[kind](machine(), where, variant), np.array(true)
    runs = (plain(form), recorded(effect, values, form))
    motion = smooth(Recording(folder=Path(), model_path=Path(), runs=runs), machine())
    balance = Balance(machine(), motion)
    readings = np.sqrt(np.mean(balance.readings.foretold**2, axis=0))
    scale = np.concatenate([machine().load_scales, readings])
    inner = slice(round(END_S / motion.step), -round(END_S / motion.step))

    def seen(series: Array) -> Array:
        return low_passed(series, motion.band / 1.35, motion.step)[inner] / scale

    without, with_it = map(seen, motion.split(balance.residual))
    forces = balance.forces(effect, values)
    contacts = CONTACTS if np.any(forces.dry) else (USUAL,)
    columns = (forces.with_contact(balance.directions[name]) for name in contacts)
    left = [with_it - without - seen(motion.split(column)[1]) for column in columns]
    power = float(np.sum((with_it - without) ** 2))
    return 1 - min(float(np.sum(each**2)) for each in left) / power


def least(case: Case) -> float:
    return LEAST.get(case[:2], LEAST.get(case[0], 0.98))  # type: ignore[call-overload]


def named(case: Case) -> str:
    return "-".join(case[:3])


@pytest.mark.parametrize("case", FEW, ids=named)
def test_a_column_is_the_residual_of_its_effect(case: Case) -> None:
    assert explained(case, "forward") > least(case)


@pytest.mark.slow
@pytest.mark.parametrize("case", [*ALL, *DRIVES], ids=named)
def test_columns_of_all_kinds_are_the_residuals_of_their_effects(case: Case) -> None:
    hidden = case[0] == "torque_constant" or case[1] == "shake"
    if not hidden:
        assert explained(case, "forward") > least(case)
    if case not in DRIVES:
        assert explained(case, "inverse") > least(case)


def test_every_kind_has_a_column_that_is_checked() -> None:
    own = set(EFFECTS) - NOT_HERE
    assert {case[0] for case in (*FEW, *ALL, *DRIVES)} >= own & set(CATALOGUE)


def test_a_column_of_one_joints_motion_has_its_share_of_the_noise_of_a_reading() -> None:
    """Also of its second rate, which a delay and its slope leave together, by the frequency."""
    log = Recording(folder=Path(), model_path=Path(), runs=(plain("inverse"),))
    balance, joints = Balance(machine(), smooth(log, machine())), len(machine().joints)
    reading = next(k for k in range(len(balance.readings.names)) if balance.readings.accelerated(k))
    grid = grid_of(balance, joints + reading)
    bands = np.unique(grid.turn)
    parts = balance.readings.by_joint[:, :, reading].T
    second = rates(parts, balance.motion.step, 2)
    same, bent = (
        noise_beside(balance, joints + reading, bands, grid.whitened(columns))
        for columns in (parts, second)
    )
    shares = balance.readings.foretold_variance(reading, bands[2:] / (2 * np.pi))
    shares /= balance.noise(joints + reading, bands[2:] / (2 * np.pi))[:, None] ** 2
    np.testing.assert_allclose(same[2:], shares, rtol=0.3, atol=1e-3)
    np.testing.assert_allclose(bent[2:], -(bands[2:, None] ** 2) * same[2:], rtol=0.5, atol=1e-3)
    assert same[2:].max() > 0.1
