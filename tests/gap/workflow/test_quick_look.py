"""Quick look: what it ranks first, and what it says where nothing is missing."""

from __future__ import annotations

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest

from loose_env.cli.main import main
from loose_env.gap.settings import GapSettings
from loose_env.gap.workflow.quick_look import FORMAT, QuickLook, quick_look
from loose_env.recording import Recording, Run, read_recording, write_recording
from tests.gap.cases.gap_case import DAMPING, GAIN, record

KINDS = ("viscous_friction", "sensor_gain", "coulomb_friction", "link_mass")


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return record(tmp_path_factory.mktemp("gap") / "recording")


def test_the_leading_hypothesis_explains_and_the_rest_follows(recording: Recording) -> None:
    lines: list[str] = []
    settings = GapSettings(kinds=KINDS, threads=1)
    look = quick_look(recording, settings, say=lines.append)
    assert look.before > 3
    first, *others = look.candidates
    assert len(look.candidates) <= 3
    named = {effect.kind for effect in first.effects}
    assert named <= {"viscous_friction", "sensor_gain"} and named
    assert first.explained > 0.5 and first.held_out_z > 3 and first.held_out < look.before
    assert all(each.held_out > 0 for each in others)
    assert any("noise standard deviations" in words for words in look.location_words)
    assert any("screening" in line or "nominal model" in line for line in lines)
    values = {
        effect.kind: parameters
        for effect, parameters in zip(first.effects, first.parameters, strict=True)
    }
    if "viscous_friction" in values:
        assert values["viscous_friction"]["damping"] == pytest.approx(DAMPING, rel=0.3)
    if "sensor_gain" in values:
        assert values["sensor_gain"]["gain"] == pytest.approx(GAIN, rel=0.3)


def test_the_command_writes_one_file_and_says_that_it_does_not_decide(
    recording: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    words = ["gap", str(recording.folder), "--quick", "--ignore-doctor", "--out", str(out)]
    assert main([*words, "--kinds", *KINDS, "--threads", "1"]) == 0
    assert "does not decide" in capsys.readouterr().out
    assert sorted(path.name for path in out.iterdir() if path.name != ".gap") == ["quick.json"]
    whole = json.loads((out / "quick.json").read_text(encoding="utf-8"))
    assert whole["format"] == FORMAT and whole["candidates"]


def test_what_a_quick_look_cannot_write_is_refused(
    recording: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["gap", str(recording.folder), "--quick", "--out", str(tmp_path / "out")]
    assert main([*words, "--rerun", str(tmp_path / "motion.rrd")]) == 1
    assert "leave one of them out" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_nothing_is_ranked_where_the_residual_is_noise(tmp_path: Path) -> None:
    from loose_env.report import quick_text

    assert QuickLook(before=1.0).candidates == ()
    assert "it is white" in quick_text(QuickLook(before=1.0))
    folder = record(tmp_path / "recording", missing=False).folder
    look = quick_look(read_recording(folder), GapSettings(kinds=KINDS, threads=1))
    assert look.candidates == () and look.before < 1.25


def test_many_short_runs_that_begin_in_motion_are_looked_at(tmp_path: Path) -> None:
    """Windows leave runs out, whose initial states are none of the others'."""
    xml = """<mujoco><option timestep="0.01" integrator="RK4"/><worldbody><body name="rod">
    <joint name="pivot" axis="0 1 0" damping="{}"/><inertial pos="0 0 -0.3" mass="0.5"
    diaginertia="0.01 0.01 0.001"/></body></worldbody>
    <actuator><motor name="m" joint="pivot"/></actuator>
    <sensor><jointpos name="encoder" joint="pivot"/></sensor></mujoco>"""
    model, rng = mujoco.MjModel.from_xml_string(xml.format(0.05)), np.random.default_rng(1)
    runs = []
    for number in range(12):
        data, shown = mujoco.MjData(model), np.zeros(120)
        data.qpos[0], data.qvel[0] = 0.3 + 0.05 * number, 1.5
        for k in range(120):
            mujoco.mj_step1(model, data)
            shown[k] = data.sensordata[0] + 1e-4 * rng.normal()
            mujoco.mj_step2(model, data)
        time = 0.01 * np.arange(120)
        runs.append(
            Run(
                name=f"run-{number:02d}.csv",
                time=time,
                sensors={"encoder": shown},
                controls={"m": np.zeros(120)},
            )
        )
    folder = tmp_path / "rod"
    write_recording(folder, model_xml=xml.format(0.01), runs=runs, file_format="csv")
    kinds = ("viscous_friction", "link_mass")
    look = quick_look(read_recording(folder), GapSettings(kinds=kinds, threads=1))
    assert [each.kind for each in look.candidates[0].effects] == ["viscous_friction"]
    assert look.candidates[0].parameters[0]["damping"] == pytest.approx(0.04, rel=0.1)
