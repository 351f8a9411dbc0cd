"""The study of the corrected arm: its pieces, and a short run from recording to verdicts."""

from __future__ import annotations

import dataclasses
import importlib
from pathlib import Path
from types import ModuleType

import mujoco
import numpy as np
import pytest
from scipy.stats import binomtest

pytest.importorskip("matplotlib")
pytest.importorskip("numba")

from loose_env.arms import describe_file

MODE = 60.0


@pytest.fixture(scope="module")
def study() -> ModuleType:
    return importlib.import_module("scripts.studies.corrected_arm")


def test_the_true_arm_is_the_nominal_one_with_a_spring_of_the_mode(
    study: ModuleType, tmp_path: Path
) -> None:
    settings = dataclasses.replace(study.Settings(), off=0.0)
    path = tmp_path / "true.xml"
    path.write_text(study.true_xml(settings, MODE))
    found = describe_file(path)
    assert found.springs == ("shoulder_gear",)
    assert found.spring_modes[0] == pytest.approx(MODE, rel=1e-3)
    nominal = mujoco.MjModel.from_xml_string(study.NOMINAL)
    true = mujoco.MjModel.from_xml_path(str(path))
    np.testing.assert_allclose(true.body_mass, nominal.body_mass)
    off = mujoco.MjModel.from_xml_string(study.true_xml(study.Settings(), MODE))
    apart = np.abs(off.body_mass[1:] / nominal.body_mass[1:] - 1)
    assert 0 < apart.max() <= 2 * study.Settings().off


def test_the_recording_is_of_the_true_arm_with_the_nominal_model(
    study: ModuleType, tmp_path: Path
) -> None:
    settings = dataclasses.replace(study.Settings(), runs=2, run_seconds=0.3)
    recording = study.record(settings, MODE, tmp_path / "recording")
    again = study.record(settings, MODE, tmp_path / "recording")
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


@pytest.fixture(scope="module")
def small(study: ModuleType) -> object:
    return dataclasses.replace(
        study.quick(study.Settings()),
        run_seconds=1.0,
        kinds=("joint_compliance", "rotor_inertia"),
        episodes=12,
        duration=0.2,
    )


@pytest.fixture(scope="module")
def finished(
    study: ModuleType, small: object, tmp_path_factory: pytest.TempPathFactory
) -> tuple[object, list[dict[str, object]], list[int]]:
    kept: list[int] = []
    made = study.Study(small, tmp_path_factory.mktemp("corrected"), lambda line: None)
    rows = made.run([], lambda rows: kept.append(len(rows)))
    return made, rows, kept


def test_the_spring_is_named_where_it_is_and_closes_the_gap(
    study: ModuleType, small: object, finished: tuple[object, list[dict[str, object]], list[int]]
) -> None:
    made, rows, _ = finished
    (gap,) = [row for row in rows if row["what"] == "gap"]
    assert [(e["kind"], e["where"]) for e in gap["effects"]] == [("joint_compliance", "shoulder")]  # type: ignore[attr-defined]
    stiffness = gap["effects"][0]["parameters"]["stiffness"]  # type: ignore[index]
    assert stiffness == pytest.approx(study.spring_of(small, MODE)[0], rel=0.05)
    assert gap["after"] < 1.25 < 10 < gap["before"]  # type: ignore[operator]
    corrected = study.arm_of(made.corrected_path(MODE))  # type: ignore[attr-defined]
    assert corrected.joints == ("base", "shoulder", "elbow")
    assert len(corrected.gear_joints) == 1


def test_the_diagnosis_fails_on_the_nominal_model_and_recovers_on_the_corrected_one(
    study: ModuleType, finished: tuple[object, list[dict[str, object]], list[int]]
) -> None:
    _, rows, _ = finished
    found = {m: study.row_of(rows, MODE, m) for m in study.MODELS}
    assert found["nominal"]["truth"] == found["corrected"]["truth"] == found["true"]["truth"]
    nominal, corrected = (np.array(found[m]["success"]) for m in ("nominal", "corrected"))
    better, worse = int((corrected & ~nominal).sum()), int((nominal & ~corrected).sum())
    # A sign test on the arms on which the two differ: no chance at this size.
    assert binomtest(better, better + worse).pvalue < 0.01 and better > worse
    assert study.mean_of(found["corrected"], "reward", found["nominal"]).low > 0.3
    assert abs(int(corrected.sum()) - int(np.sum(found["true"]["success"]))) <= 2


def test_it_goes_on_where_it_stopped_and_prints_and_draws(
    study: ModuleType,
    small: object,
    finished: tuple[object, list[dict[str, object]], list[int]],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    made, rows, kept = finished
    assert kept == [1, 2, 3, 4, 5]
    before = [dict(row) for row in rows]
    again = made.run(rows[:-1], lambda rows: None)  # type: ignore[attr-defined]
    assert again == before
    study.print_tables(rows)
    said = capsys.readouterr().out
    assert "joint_compliance@shoulder" in said and "corrected" in said
    study.draw(rows, small, tmp_path / "figure.png")
    assert (tmp_path / "figure.png").stat().st_size > 10_000
