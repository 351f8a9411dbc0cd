"""The step of the simulation: measured where the runs are fast, warned of where it is coarse."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from loose_env.gap.data.aligned_run import channels_of
from loose_env.gap.model.effects.drives.actuators import ActuatorGain
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.residuals.preparation.integrator_choice import (
    Integration,
    choose_integration,
    corrected_step_notes,
)
from loose_env.gap.residuals.preparation.prepare import prepare
from loose_env.gap.settings import GapSettings
from loose_env.recording import Run, write_recording
from loose_env.typing import Array

RK4 = int(mujoco.mjtIntegrator.mjINT_RK4)
ARM = """
<mujoco>
  <option timestep="{step}"/>
  <worldbody>
    <body name="link">
      <joint name="turn" axis="0 1 0" damping="0.2" armature="0.02"/>
      <inertial pos="0 0 -0.3" mass="1" diaginertia="0.01 0.01 0.01"/>
      <site name="tool" pos="0 0 -0.5"/>
    </body>
  </worldbody>
  <actuator><position name="servo" joint="turn" kp="{kp}" kv="{kv}"/></actuator>
  <sensor><jointpos name="q" joint="turn"/></sensor>
</mujoco>
"""


def run_of(
    command: Array,
    *,
    noise: float,
    interval: float = 0.01,
    name: str = "a.csv",
    kp: float = 100.0,
    kv: float = 4.0,
) -> Run:
    """A run of this arm, finely simulated, with noise."""
    model = mujoco.MjModel.from_xml_string(ARM.format(step=interval / 100, kp=kp, kv=kv))
    model.opt.integrator = RK4
    data, shown = mujoco.MjData(model), np.zeros(len(command))
    for k, value in enumerate(command):
        shown[k], data.ctrl[0] = data.qpos[0], value
        mujoco.mj_step(model, data, 100)
    shown = shown + np.random.default_rng(1).normal(0, noise, len(shown))
    return Run(
        name=name, time=interval * np.arange(len(command)), controls={"servo": command},
        sensors={"q": shown},
    )  # fmt: skip


def wave(rate: float, seconds: float, *, still: float = 0.0, interval: float = 0.01) -> Array:
    """A sine of so many turns a second, after some time of rest."""
    time = interval * np.arange(round(seconds / interval))
    return 0.5 * np.sin(2 * np.pi * rate * np.maximum(time - still, 0.0))


def chosen(*runs: Run, step: float = 0.01, kp: float = 100.0) -> Integration:
    machine = NominalModel(mujoco.MjSpec.from_string(ARM.format(step=step, kp=kp, kv=4.0)))
    return choose_integration(machine, runs, channels_of(list(runs)), threads=1)


def test_what_happens_after_the_beginning_counts() -> None:
    still = chosen(run_of(wave(3.0, 2.0, still=2.0), noise=1e-3))
    late = chosen(run_of(wave(3.0, 6.0, still=2.5), noise=1e-3))
    assert still.nominal_error < 0.1
    assert late.nominal_error > 1


def test_a_step_that_stays_too_coarse_is_warned_of(tmp_path: Path) -> None:
    # a servo of 500 Hz, which no sixteenth of 20 ms follows
    interval, kp = 0.02, 0.12 * (2 * np.pi * 500) ** 2
    runs = [
        run_of(wave(1.0, 4.0, interval=interval), noise=1e-5, interval=interval, name=name, kp=kp)
        for name in ("a.csv", "b.csv")
    ]
    found = chosen(*runs, step=0.02, kp=kp)
    assert found.error > 0.1
    assert any("still" in words for words in found.notes(own=0.02))
    recording = write_recording(
        tmp_path / "r", model_xml=ARM.format(step=0.02, kp=kp, kv=4.0), runs=runs, file_format="csv"
    )
    warnings = prepare(recording, GapSettings(threads=1, kinds=("viscous_friction",))).warnings
    assert any("still" in words and "finer" in words for words in warnings)


def test_a_corrected_model_that_needs_a_finer_step_is_warned_of(tmp_path: Path) -> None:
    """The machine's servo is ten times as stiff as its model, for which a coarse step will do."""
    runs = [
        run_of(wave(1.0, 4.0), noise=1e-5, name=name, kp=1000.0, kv=40.0)
        for name in ("a.csv", "b.csv")
    ]
    recording = write_recording(
        tmp_path / "r",
        model_xml=ARM.format(step=0.01, kp=100.0, kv=4.0),
        runs=runs,
        file_format="csv",
    )
    problem = prepare(recording, GapSettings(threads=1, kinds=("viscous_friction",)))
    held = problem.held_out_whole
    assert corrected_step_notes(held, Hypothesis()) == []
    gain = ActuatorGain(problem.machine, "servo")
    corrected = Hypothesis(effects=(gain,), values=(np.array([10.0]),))
    (words,) = corrected_step_notes(held, corrected)
    assert "finer step" in words and "sensor.q" in words
