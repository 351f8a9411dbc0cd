"""Warnings and refusals before the search: short or still runs, conditions, names, coarse steps."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from loose_env.errors import InvalidData
from loose_env.gap import GapSettings, Hypothesis
from loose_env.gap.model.effects.drives.actuators import ActuatorGain
from loose_env.gap.residuals.preparation.integrator_choice import corrected_step_notes
from loose_env.gap.residuals.preparation.prepare import prepare
from loose_env.recording import Recording, Run, write_recording
from loose_env.typing import Array
from tests.gap.cases.effect_arms import PLANAR

SETTINGS = GapSettings(threads=1)


def recorded(
    folder: Path,
    *,
    seconds: float = 1.0,
    swings: tuple[float, float, float] = (0.3, 0.3, 0.3),
    conditions: str = "   ",
    model: str = PLANAR,
) -> Recording:
    """Three runs whose joints swing so far [rad]; "s" is a suspect, "h" a healthy one."""
    rng = np.random.default_rng(8)
    time = 0.002 * np.arange(round(seconds / 0.002))
    runs = []
    for number, condition in enumerate(conditions):
        waves = np.sin(np.outer(time, rng.uniform(3.0, 9.0, 3))) * np.array(swings)
        shown = waves + rng.normal(0.0, 5e-5, waves.shape)
        run = Run(
            name=f"run-{number}.parquet",
            time=time,
            controls={f"servo{j + 1}": waves[:, j] for j in range(3)},
            sensors={f"encoder{j + 1}": shown[:, j] for j in range(3)},
        )
        words = {"s": "suspect", "h": "healthy"}
        runs.append(replace(run, condition=words[condition]) if condition in words else run)
    return write_recording(folder, model_xml=model, runs=runs)


def warned(recording: Recording, word: str) -> list[str]:
    return [words for words in prepare(recording, SETTINGS).warnings if word in words]


def test_data_that_show_too_little_are_told_of_with_what_to_record(tmp_path: Path) -> None:
    enough = recorded(tmp_path / "enough", seconds=4.0)
    assert not warned(enough, "hardly moves") and not warned(enough, "independent")
    short = warned(recorded(tmp_path / "short", seconds=0.5), "independent")
    assert any("to fit to last 1 s in all" in w and "s more of them" in w for w in short)
    still = recorded(tmp_path / "still", seconds=4.0, swings=(0.3, 0.0, 0.3))
    (words,) = warned(still, "hardly")
    assert words.startswith("joint2 hardly moves") and "turns round several times" in words


def test_healthy_runs_are_left_out_where_there_are_suspect_ones(tmp_path: Path) -> None:
    mixed = prepare(recorded(tmp_path / "mixed", conditions="shs"), SETTINGS)
    compared = [t.name for c in (mixed.fit, mixed.held_out_whole) for t in c.trials]
    assert compared == ["run-0.parquet", "run-2.parquet"]
    assert any("run-1.parquet" in words and "not used" in words for words in mixed.warnings)
    healthy = prepare(recorded(tmp_path / "healthy", conditions="hhh"), SETTINGS)
    assert len(healthy.fit.trials) + len(healthy.held_out_whole.trials) == 3
    assert not any("not used" in words for words in healthy.warnings)
    with pytest.raises(InvalidData, match=r"only run-2\.parquet is suspect"):
        prepare(recorded(tmp_path / "few", conditions="hhs"), SETTINGS)
    with pytest.raises(InvalidData, match="at least two are needed"):
        prepare(recorded(tmp_path / "one", conditions=" "), SETTINGS)


def test_links_without_names_and_a_tool_without_site_are_told_of(tmp_path: Path) -> None:
    bare = PLANAR.replace('<body name="link2"', "<body")
    for words in (
        '<site name="tool" pos="0.3 0 0" euler="0 0 0.3"/>',
        '<accelerometer name="shake" site="tool"/>',
    ):
        bare = bare.replace(words, "")
    warnings = prepare(recorded(tmp_path / "bare", model=bare), SETTINGS).warnings
    assert any("joint2_link" in words for words in warnings)
    assert any("no site at its tool" in words for words in warnings)


@pytest.mark.parametrize("form", ["forward", "inverse"])
def test_an_arm_that_stands_still_leaves_nothing_to_compare(tmp_path: Path, form: str) -> None:
    time, still = np.arange(1000) * 0.002, np.full(1000, 0.1)
    swing = 0.1 * np.sin(3 * time) * (form == "inverse")
    runs = [
        Run(
            name=f"run-{k}.csv",
            time=time,
            controls={f"servo{j}": still for j in (1, 2, 3)} if form == "forward" else {},
            torques={f"joint{j}": still for j in (1, 2, 3)} if form == "inverse" else {},
            sensors={f"encoder{j}": still + swing for j in (1, 2, 3)},
        )
        for k in range(2)
    ]
    recording = write_recording(tmp_path / "r", model_xml=PLANAR, runs=runs)
    with pytest.raises(InvalidData, match=r"^nothing to compare .*\(run-0\.\w+\).*Record"):
        prepare(recording, SETTINGS)


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


def waved(folder: Path, *, step: float, true: Array, model: Array) -> Recording:
    """Two runs with the gains ``true`` of a servo, finely simulated, of a model with others."""
    time = step * np.arange(round(4 / step))
    command = 0.5 * np.sin(2 * np.pi * time)
    fine = mujoco.MjModel.from_xml_string(ARM.format(step=step / 100, kp=true[0], kv=true[1]))
    fine.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    data, shown = mujoco.MjData(fine), np.zeros(len(time))
    for k, value in enumerate(command):
        shown[k], data.ctrl[0] = data.qpos[0], value
        mujoco.mj_step(fine, data, 100)
    shown = shown + np.random.default_rng(1).normal(0, 1e-5, len(shown))
    runs = [
        Run(name=name, time=time, controls={"servo": command}, sensors={"q": shown})
        for name in ("a.csv", "b.csv")
    ]
    xml = ARM.format(step=step, kp=model[0], kv=model[1])
    return write_recording(folder, model_xml=xml, runs=runs, file_format="csv")


def test_a_step_that_stays_too_coarse_is_warned_of(tmp_path: Path) -> None:
    # a servo of 500 Hz, which no sixteenth of 20 ms follows
    stiff = np.array([0.12 * (2 * np.pi * 500) ** 2, 4.0])
    warnings = prepare(waved(tmp_path / "r", step=0.02, true=stiff, model=stiff), SETTINGS).warnings
    assert any("still" in words and "finer" in words for words in warnings)


def test_a_corrected_model_that_needs_a_finer_step_is_warned_of(tmp_path: Path) -> None:
    """The machine's servo is ten times as stiff as its model, for which a coarse step will do."""
    model = np.array([100.0, 4.0])
    problem = prepare(waved(tmp_path / "r", step=0.01, true=10 * model, model=model), SETTINGS)
    assert corrected_step_notes(problem.held_out_whole, Hypothesis()) == []
    gain = ActuatorGain(problem.machine, "servo")
    corrected = Hypothesis(effects=(gain,), values=(np.array([10.0]),))
    (words,) = corrected_step_notes(problem.held_out_whole, corrected)
    assert "finer step" in words and "sensor.q" in words
