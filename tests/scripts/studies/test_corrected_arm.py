"""The study of the corrected arm: its pieces, and a short run from recording to verdicts."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.stats import binomtest

pytest.importorskip("matplotlib")
pytest.importorskip("numba")

from loose_agents.execution.study import Row, StudyRun

from loose_env.arms import describe_file
from scripts.studies import corrected_arm
from scripts.study_parts import corrected_tables, three_axis_arm

MODE = 60.0


def test_the_true_arm_is_the_nominal_one_with_a_spring_of_the_mode(tmp_path: Path) -> None:
    settings = dataclasses.replace(three_axis_arm.Settings(), off=0.0)
    path = tmp_path / "true.xml"
    path.write_text(three_axis_arm.true_xml(settings, MODE))
    found = describe_file(path)
    assert found.springs == ("shoulder_gear",)
    assert found.spring_modes[0] == pytest.approx(MODE, rel=1e-3)
    nominal = mujoco.MjModel.from_xml_string(three_axis_arm.NOMINAL)
    true = mujoco.MjModel.from_xml_path(str(path))
    np.testing.assert_allclose(true.body_mass, nominal.body_mass)
    off = mujoco.MjModel.from_xml_string(three_axis_arm.true_xml(three_axis_arm.Settings(), MODE))
    apart = np.abs(off.body_mass[1:] / nominal.body_mass[1:] - 1)
    assert 0 < apart.max() <= 2 * three_axis_arm.Settings().off


def test_the_recording_is_of_the_true_arm_with_the_nominal_model(tmp_path: Path) -> None:
    settings = dataclasses.replace(three_axis_arm.Settings(), runs=2, run_seconds=0.3)
    recording = three_axis_arm.record(settings, MODE, tmp_path / "recording")
    again = three_axis_arm.record(settings, MODE, tmp_path / "recording")
    assert [run.comparison for run in recording.runs] == ["forward"] * 2
    assert "gear" not in recording.model_path.read_text()
    for one, other in zip(recording.runs, again.runs, strict=True):
        np.testing.assert_array_equal(one.sensors["acceleration"], other.sensors["acceleration"])
    # At rest at first: nothing but gravity, and encoders where the servos hold the arm.
    first = recording.runs[0]
    assert np.linalg.norm(first.sensors["acceleration"][:5].mean(0)) == pytest.approx(
        9.81, rel=0.01
    )
    sag = first.sensors["encoder_shoulder"][0] - first.controls["hold_shoulder"][0]
    assert 1e-4 < abs(sag) < 0.03


SMALL = three_axis_arm.Settings(
    modes=(MODE,), kinds=("joint_compliance", "rotor_inertia"), episodes=12, duration=0.2
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("corrected")


@pytest.fixture(scope="module")
def rows(folder: Path) -> list[Row]:
    return corrected_arm.STUDY.rows(folder / "rows.json", SMALL, StudyRun(out=folder))


def test_the_spring_is_named_where_it_is_and_closes_the_gap(folder: Path, rows: list[Row]) -> None:
    (gap,) = [row for row in rows if row["what"] == "gap"]
    assert [(e["kind"], e["where"]) for e in gap["effects"]] == [("joint_compliance", "shoulder")]
    stiffness = gap["effects"][0]["parameters"]["stiffness"]
    assert stiffness == pytest.approx(three_axis_arm.spring_of(SMALL, MODE)[0], rel=0.05)
    assert gap["after"] < 1.25 < 10 < gap["before"]
    corrected = corrected_arm.arm_of(folder / "corrected_arm" / "full" / "gap-60" / "model.xml")
    assert corrected.joints == ("base", "shoulder", "elbow")
    assert len(corrected.gear_joints) == 1


def test_the_diagnosis_fails_on_the_nominal_model_and_recovers_on_the_corrected_one(
    rows: list[Row],
) -> None:
    found = {m: corrected_tables.row_of(rows, MODE, m) or {} for m in corrected_tables.MODELS}
    assert found["nominal"]["truth"] == found["corrected"]["truth"] == found["true"]["truth"]
    nominal, corrected = (np.array(found[m]["success"]) for m in ("nominal", "corrected"))
    better, worse = int((corrected & ~nominal).sum()), int((nominal & ~corrected).sum())
    # A sign test on the arms on which the two differ: no chance at this size.
    assert binomtest(better, better + worse).pvalue < 0.01 and better > worse
    assert corrected_tables.mean_of(found["corrected"], "reward", found["nominal"]).low > 0.3
    assert abs(int(corrected.sum()) - int(np.sum(found["true"]["success"]))) <= 2


def test_it_goes_on_where_it_stopped_and_prints_and_draws(
    folder: Path, rows: list[Row], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert len(rows) == 5
    whole = json.loads((folder / "rows.json").read_text())
    path = tmp_path / "rows.json"
    path.write_text(json.dumps(whole | {"rows": rows[:-1]}))
    assert corrected_arm.STUDY.rows(path, SMALL, StudyRun(out=folder)) == rows
    corrected_arm.main(["--show", str(path), "--out", str(path.with_suffix(".png"))])
    said = capsys.readouterr().out
    assert "joint_compliance@shoulder" in said and "corrected" in said
    assert path.with_suffix(".png").stat().st_size > 10_000
