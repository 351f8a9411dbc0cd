from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from loose_env.cli.main import main
from loose_env.errors import InvalidData, InvalidSetting
from loose_env.instrument import read_recorded_arm
from loose_env.instrument.pipeline import Workbench, diagnose
from loose_env.instrument.result import Diagnosis, read_diagnosis
from loose_env.instrument.settings.diagnosis import DiagnoseSettings
from loose_env.recording import Run, read_recording, write_recording
from loose_env.report import diagnosis_text
from tests.instrument.arms.blind_arm import SLIDE, runs, write_model

QUICK = DiagnoseSettings(poses=2, seconds=1.0)


def weighed(folder: Path, given: tuple[Run, ...], *, plan: bool = False) -> Diagnosis:
    bench = Workbench(write_model(folder), QUICK)
    for run in given:
        bench.add(run)
    return bench.diagnosis(plan=plan)


@pytest.fixture(scope="module")
def slide(tmp_path_factory: pytest.TempPathFactory) -> Diagnosis:
    return weighed(tmp_path_factory.mktemp("slide"), runs("slide", 3))


@pytest.fixture(scope="module")
def healthy(tmp_path_factory: pytest.TempPathFactory) -> Diagnosis:
    return weighed(tmp_path_factory.mktemp("healthy"), runs("healthy", 3))


@pytest.fixture(scope="module")
def one_run(tmp_path_factory: pytest.TempPathFactory) -> Diagnosis:
    """Of one run of the slide, with the next pose."""
    return weighed(tmp_path_factory.mktemp("one"), runs("slide", 1), plan=True)


def test_a_loose_link_of_an_arm_that_mujoco_never_saw_is_named(slide: Diagnosis) -> None:
    assert slide.fault.hypothesis == "structural_looseness@link2"
    assert slide.probability > 0.95
    assert slide.fault.direction is not None
    true = np.array(SLIDE.parameters["direction"])
    off = np.degrees(np.arccos(min(1.0, abs(float(true @ np.array(slide.fault.direction))))))
    assert off < 8.0
    assert slide.fault.direction_half_angle_deg is not None
    assert off < slide.fault.direction_half_angle_deg
    own = slide.directions["link2"]
    assert own.axis == slide.fault.direction
    assert own.half_angle_deg == slide.fault.direction_half_angle_deg
    assert set(slide.directions) <= {"link1", "link2", "link3"}


def test_every_run_has_its_probabilities_its_direction_and_its_loop(slide: Diagnosis) -> None:
    assert [record.file for record in slide.records] == [f"run-{k}.parquet" for k in (1, 2, 3)]
    for record in slide.records:
        assert np.isclose(sum(record.probabilities.values()), 1.0)
        assert record.direction_tool is not None
        assert np.isclose(np.linalg.norm(record.direction_tool), 1.0)
        (loop,) = record.loops
        assert loop.joint == record.excited[0]
        assert max(map(abs, loop.correlation)) <= 1.0
    assert slide.records[-1].probabilities == slide.posterior


def test_one_run_settles_nothing_and_three_do(one_run: Diagnosis, slide: Diagnosis) -> None:
    assert one_run.fault.hypothesis == slide.fault.hypothesis
    assert not one_run.settled and one_run.verdict == "open"
    assert any("2 are needed" in words for words in one_run.open_because)
    assert slide.settled and slide.verdict == "faulty" and not slide.open_because


@pytest.mark.slow
def test_a_diagnosis_that_finds_no_further_pose_is_not_called_settled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def nothing(*_: object, **__: object) -> None:
        raise InvalidData("no pose will do")

    monkeypatch.setattr("loose_env.instrument.pipeline.next_for", nothing)
    found = weighed(tmp_path, runs("slide", 1), plan=True)
    assert found.next is None
    model = tmp_path / "model.xml"
    assert found.verdict == "open"
    arm = read_recorded_arm(model).shown
    assert "Take nothing apart yet: the case is open." in diagnosis_text(found, arm)
    decided = dataclasses.replace(found, settled=True, verdict="faulty")
    assert "the case is open" not in diagnosis_text(decided, arm)


def test_the_next_pose_says_when_nothing_is_known_of_collisions(one_run: Diagnosis) -> None:
    assert one_run.next is not None
    assert any("without knowing what link1, link2" in words for words in one_run.warnings)


@pytest.mark.slow
def test_the_next_band_is_the_one_that_is_asked_for(tmp_path: Path) -> None:
    asked = dataclasses.replace(QUICK, band_low=12.0, band_high=60.0)
    bench = Workbench(write_model(tmp_path), asked)
    bench.add(runs("slide", 1)[0])
    following = bench.diagnosis().next
    assert following is not None
    assert 12.0 <= following.band_hz[0] < following.band_hz[1] <= 60.0
    assert following.settings["band_high"] == 60.0


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["slide", "healthy"])
def test_after_a_run_stand_the_probabilities_by_the_runs_up_to_it(
    tmp_path: Path, kind: str
) -> None:
    whole = weighed(tmp_path, runs("slide", 1, sound=True) + runs(kind, 3))
    steps = [record.probabilities for record in whole.records]
    assert steps[0] == {}
    assert steps[3] == pytest.approx(dict(whole.posterior), abs=1e-12)
    true = "structural_looseness@link2" if kind == "slide" else "healthy"
    assert all(sum(step.values()) == pytest.approx(1.0) for step in steps[1:])
    assert steps[1][true] <= steps[3][true]  # both may be as sure as a probability can be


@pytest.mark.slow
def test_play_is_told_from_a_slide(tmp_path: Path) -> None:
    found = weighed(tmp_path, runs("play"))
    assert found.fault.hypothesis == "backlash@joint2"
    assert found.fault.direction is None


def test_a_healthy_arm_is_called_healthy(healthy: Diagnosis) -> None:
    assert healthy.fault.kind == "healthy" and healthy.nothing_opened > 0.9
    assert healthy.fault.direction is None and healthy.fault.gap_m is None


@pytest.mark.slow
def test_a_whisper_does_not_prove_health(tmp_path: Path, healthy: Diagnosis) -> None:
    """At a level that opens no seat the data say little, and the reader is told."""
    faint = weighed(tmp_path, runs("healthy", 3, 0.002))
    assert faint.posterior["healthy"] < healthy.posterior["healthy"]
    assert faint.posterior["healthy"] < 0.9
    assert any("open a seat" in words or "shut" in words for words in faint.warnings)


def test_references_of_the_sound_arm_are_used_and_not_judged(tmp_path: Path) -> None:
    found = weighed(tmp_path, runs("slide", sound=True) + runs("slide", 1))
    assert found.fault.hypothesis == "structural_looseness@link2"
    assert [r.condition for r in found.records] == ["healthy", "healthy", "suspect"]
    assert not found.records[0].probabilities


@pytest.mark.slow
def test_pose_and_joint_are_taken_from_the_data_with_a_warning(
    tmp_path: Path, slide: Diagnosis
) -> None:
    bare = tuple(dataclasses.replace(run, pose=None, excited=()) for run in runs("slide", 3))
    found = weighed(tmp_path, bare)
    assert found.fault.hypothesis == slide.fault.hypothesis
    assert [r.excited for r in found.records] == [r.excited for r in slide.records]
    assert any("no 'pose' is noted" in words for words in found.warnings)
    assert any("no 'excited' is noted" in words for words in found.warnings)


@pytest.mark.slow
def test_another_arm_than_the_model_is_noticed(tmp_path: Path) -> None:
    path = write_model(tmp_path)
    text = path.read_text("utf-8").replace('mass="2.5"', 'mass="6"')
    assert text != path.read_text("utf-8")
    path.write_text(text, encoding="utf-8")
    bench = Workbench(path, QUICK)
    for run in runs("healthy", 3):
        bench.add(run)
    found = bench.diagnosis(plan=False)
    assert any("loose gap" in words for words in found.warnings)


def test_a_moving_arm_is_no_held_pose(tmp_path: Path) -> None:
    run = runs("healthy", 1)[0]
    sensors = dict(run.sensors)
    sensors["joint1_pos"] = sensors["joint1_pos"] + np.sin(3 * run.time)
    bench = Workbench(write_model(tmp_path), QUICK)
    with pytest.raises(InvalidData, match="joint1 moves by"):
        bench.add(dataclasses.replace(run, sensors=sensors))


def test_a_run_without_an_accelerometer_is_refused(tmp_path: Path) -> None:
    run = runs("healthy", 1)[0]
    sensors = {k: v for k, v in run.sensors.items() if k != "tool_acc"}
    bench = Workbench(write_model(tmp_path), QUICK)
    with pytest.raises(InvalidData, match="no accelerometer of the arm was recorded"):
        bench.add(dataclasses.replace(run, sensors=sensors))


def test_references_alone_are_no_recording_to_judge(tmp_path: Path) -> None:
    write_model(tmp_path)
    write_recording(
        tmp_path / "r", model_xml=tmp_path / "model.xml", runs=runs("healthy", 1, sound=True)
    )
    with pytest.raises(InvalidData, match="all runs are healthy references"):
        diagnose(read_recording(tmp_path / "r"), QUICK)


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ({"healthy_prior": 1.0}, "healthy_prior is a probability"),
        ({"sure": float("nan")}, "sure is a finite number"),
        ({"seconds": 0.0}, "seconds is a length"),
        ({"inertial_parameters": -0.1}, "inertial_parameters is a standard deviation"),
        ({"poses": 0}, "poses is a whole number"),
        ({"poses": 2.5}, "poses is a whole number"),
        ({"seed": "a"}, "seed is a whole number"),
        ({"healthy_prior": "a"}, "healthy_prior is a finite number"),
        ({"inertial_parameters": None}, "inertial_parameters is a finite number"),
        ({"most_tool": -1.0}, "most_tool is a positive number"),
        ({"torque_share": 2.0}, "torque_share is above 0"),
        ({"band_low": 50.0, "band_high": 20.0}, "a band goes upwards"),
    ],
)
def test_settings_that_make_no_sense_are_refused(setting: dict[str, float], words: str) -> None:
    with pytest.raises(InvalidSetting, match=words):
        DiagnoseSettings(**setting)  # type: ignore[arg-type]


@pytest.mark.slow
def test_the_command_writes_a_result_and_takes_a_longer_recording(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model, folder, out = write_model(tmp_path), tmp_path / "recording", tmp_path / "found"
    options = ["--out", str(out), "--quiet", "--poses", "2", "--seconds", "1"]
    for count in (1, 3):
        write_recording(folder, model_xml=model, runs=runs("slide", count), overwrite=True)
        assert main(["diagnose", str(folder), *options]) == 0
        found = read_diagnosis(out)
        assert len(found.records) == count
        assert json.loads((out / "result.json").read_text())["format"] == "loose-diagnosis/1"
    assert "Link 2 is loose." in capsys.readouterr().out
    assert not [path.name for path in out.iterdir() if ".part" in path.name]


def test_an_interrupted_diagnosis_says_that_it_begins_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write_recording(tmp_path / "r", model_xml=write_model(tmp_path), runs=runs("slide", 1))

    def stopped(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("loose_env.cli.instrument.diagnose", stopped)
    assert main(["diagnose", str(tmp_path / "r"), "--out", str(tmp_path / "found")]) == 130
    said = capsys.readouterr().err
    assert said == "loose diagnose: interrupted; the same command begins anew\n"


def test_a_result_of_the_other_command_is_kept(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_recording(tmp_path / "r", model_xml=write_model(tmp_path), runs=runs("slide", 1))
    out = tmp_path / "out"
    (out / ".gap").mkdir(parents=True)
    (out / "result.json").write_text('{"format": "loose-gap/1"}')
    assert main(["diagnose", str(tmp_path / "r"), "--out", str(out)]) == 1
    said = capsys.readouterr().err
    assert "holds what 'loose gap' wrote" in said and said.count("\n") == 1
    assert (out / "result.json").read_text() == '{"format": "loose-gap/1"}'


@pytest.mark.slow
def test_a_result_never_stands_beside_the_page_of_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    model, folder, out = write_model(tmp_path), tmp_path / "recording", tmp_path / "found"
    write_recording(folder, model_xml=model, runs=runs("slide", 1))
    given = [
        "diagnose",
        str(folder),
        "--out",
        str(out),
        "--quiet",
        "--poses",
        "2",
        "--seconds",
        "1",
    ]
    assert main(given) == 0

    def cut_short(*_: object, **__: object) -> Path:
        raise KeyboardInterrupt

    monkeypatch.setattr("loose_env.report.diagnosis.write_page", cut_short)
    assert main(given) == 130
    assert not (out / "result.json").exists()
    monkeypatch.undo()
    assert main(given) == 0
    assert read_diagnosis(out).records


def test_what_cannot_be_used_is_said_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["diagnose", str(tmp_path), "--out", str(tmp_path / "found")]) == 1
    said = capsys.readouterr().err
    assert said.startswith("loose diagnose: ") and said.count("\n") == 1


@pytest.mark.slow
def test_joints_may_have_the_names_that_seats_have_here(tmp_path: Path) -> None:
    """A name that the package's own joints begin with is the model's all the same."""
    text = write_model(tmp_path).read_text("utf-8").replace('"joint2"', '"seat_turn"')
    own = {"joint2": "seat_turn"}
    renamed = [
        dataclasses.replace(
            run,
            pose={own.get(joint, joint): q for joint, q in (run.pose or {}).items()},
            excited=tuple(own.get(joint, joint) for joint in run.excited),
        )
        for run in runs("play", 2)
    ]
    write_recording(tmp_path / "r", model_xml=text, runs=renamed)
    out = tmp_path / "found"
    options = ["--quiet", "--poses", "2", "--seconds", "1"]
    assert main(["diagnose", str(tmp_path / "r"), "--out", str(out), *options]) == 0
    assert read_diagnosis(out).fault.where == "seat_turn"
    assert "seat_turn" in (out / "report.html").read_text("utf-8")
    assert "file_seat_turn" not in (out / "report.html").read_text("utf-8")


def test_a_band_that_the_arm_does_not_have_costs_the_next_pose_alone(tmp_path: Path) -> None:
    write_recording(tmp_path / "r", model_xml=write_model(tmp_path), runs=runs("slide", 1))
    settings = DiagnoseSettings(poses=2, seconds=1.0, band_high=1.0)
    found = diagnose(read_recording(tmp_path / "r"), settings)
    assert found.next is None
    assert any("nothing next: a band from" in words for words in found.warnings)
