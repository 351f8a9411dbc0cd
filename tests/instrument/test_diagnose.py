"""Diagnosis of recordings: faults, spoilt runs, clocks, references, sessions, settings."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from loose_env.cli.main import main
from loose_env.errors import InvalidData, InvalidSetting
from loose_env.importing.timing.resampling import resampled
from loose_env.instrument import (
    DiagnoseSettings,
    Diagnosis,
    InstrumentedArm,
    ModelSettings,
    diagnose,
    find_fault,
    read_arm,
    read_diagnosis,
    read_recorded_arm,
)
from loose_env.recording import Recording, Run, read_recording, write_recording
from loose_env.report import diagnosis_text
from loose_env.rig import RecordedRig
from scripts.suites.diagnosis.cases import BlindArm
from scripts.suites.golden import DIAGNOSES, write_shaken_recording
from tests.instrument.arms import SERVOED, SLIDE, case, runs, strike, write_model, written

QUICK = DiagnoseSettings(poses=2, seconds=1.0)


def found_in(
    folder: Path,
    given: Sequence[Run],
    settings: DiagnoseSettings = QUICK,
    *,
    plan: bool = False,
    edit: Callable[[str], str] = str,
) -> Diagnosis:
    """Diagnosis of runs of the machine that MuJoCo never saw."""
    model = write_model(folder)
    model.write_text(edit(model.read_text("utf-8")), "utf-8")
    recording = Recording(folder=folder, model_path=model, runs=tuple(given))
    return diagnose(recording, settings, plan=plan)


def with_sensors(run: Run, change: Callable[[str, np.ndarray], np.ndarray]) -> Run:
    return replace(run, sensors={name: change(name, v) for name, v in run.sensors.items()})


def without(run: Run, *sensors: str) -> Run:
    left = {name: values for name, values in run.sensors.items() if name not in sensors}
    return replace(run, sensors=left)


def rows(run: Run, kept: np.ndarray) -> Run:
    """A run of which only some rows were written."""
    controls, sensors, torques = (
        {name: values[kept] for name, values in columns.items()}
        for columns in (run.controls, run.sensors, run.torques)
    )
    return replace(run, time=run.time[kept], controls=controls, sensors=sensors, torques=torques)


def missing(run: Run, sensor: str, where: slice | np.ndarray) -> Run:
    """A run of which samples of a sensor are not there."""
    values = run.sensors[sensor].copy()
    values[where] = np.nan
    return replace(run, sensors={**run.sensors, sensor: values})


def jumping(run: Run, row: int, seconds: float) -> Run:
    """A run whose clock jumps."""
    return replace(run, time=run.time + seconds * (np.arange(run.samples) >= row))


@pytest.fixture(scope="module")
def slide(tmp_path_factory: pytest.TempPathFactory) -> Diagnosis:
    return found_in(tmp_path_factory.mktemp("slide"), runs("slide", 2))


@pytest.fixture(scope="module")
def spoilt(tmp_path_factory: pytest.TempPathFactory) -> Diagnosis:
    """Of one run of the slide with defects beside one that cannot be used, with the next pose."""
    run = runs("slide", 1)[0]
    still = np.full(run.samples, 0.25)
    still[300:900] = np.nan
    run = replace(run, sensors={**run.sensors, "joint2_vel": still})
    run = replace(run, pose={**(run.pose or {}), "joint1": 0.5})
    unused = replace(without(run, "tool_acc"), name="unused", pose={"joint1": 0.5})
    return found_in(tmp_path_factory.mktemp("spoilt"), (unused, run), plan=True)


@pytest.fixture(scope="module")
def shaken(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """Two runs of a healthy arm of two joints."""
    folder = tmp_path_factory.mktemp("shaken") / "recording"
    write_shaken_recording(folder, **DIAGNOSES["healthy, flat"])
    return read_recording(folder)


def of_shaken(shaken: Recording, *given: Run, plan: bool = False, **settings: float) -> Diagnosis:
    return diagnose(replace(shaken, runs=given), replace(QUICK, **settings), plan=plan)


# ------------------------------------------------------------------------- faults


def test_a_loose_link_of_an_arm_that_mujoco_never_saw_is_named(slide: Diagnosis) -> None:
    assert slide.fault.hypothesis == "structural_looseness@link2"
    assert slide.probability > 0.95
    assert slide.settled and slide.verdict == "faulty" and not slide.open_because
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
    assert [record.file for record in slide.records] == ["run-1.parquet", "run-2.parquet"]
    for record in slide.records:
        assert np.isclose(sum(record.probabilities.values()), 1.0)
        assert record.direction_tool is not None
        assert np.isclose(np.linalg.norm(record.direction_tool), 1.0)
        (loop,) = record.loops
        assert loop.joint == record.excited[0]
        assert max(map(abs, loop.correlation)) <= 1.0
    assert slide.records[-1].probabilities == slide.posterior


def test_one_run_settles_nothing_and_asks_for_the_next(spoilt: Diagnosis) -> None:
    assert spoilt.fault.kind == "structural_looseness"
    assert not spoilt.settled and spoilt.verdict == "open"
    assert any("2 are needed" in words for words in spoilt.open_because)
    assert spoilt.next is not None
    assert any("without knowing what link1, link2" in words for words in spoilt.warnings)


def test_a_healthy_arm_is_called_healthy_though_samples_are_missing(tmp_path: Path) -> None:
    def scattered(_: str, values: np.ndarray) -> np.ndarray:
        values = values.copy()
        values[[300, 700, 701, 1200]] = np.nan
        return values

    found = found_in(tmp_path, [with_sensors(runs("healthy", 1)[0], scattered)])
    assert found.fault.kind == "healthy" and found.nothing_opened > 0.9
    assert found.fault.direction is None and found.fault.gap_m is None
    notes = " ".join(found.records[0].notes)
    assert "no sample of" not in notes and "is not used" not in notes


@pytest.mark.slow
def test_play_is_told_from_a_slide_whatever_the_joint_is_called(tmp_path: Path) -> None:
    """A name that the package's own joints begin with is the model's all the same."""
    text = write_model(tmp_path).read_text("utf-8").replace('"joint2"', '"seat_turn"')
    own = {"joint2": "seat_turn"}
    renamed = [
        replace(
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
    fault = read_diagnosis(out).fault
    assert (fault.hypothesis, fault.direction) == ("backlash@seat_turn", None)
    page = (out / "report.html").read_text("utf-8")
    assert "seat_turn" in page and "file_seat_turn" not in page


@pytest.mark.slow
def test_a_whisper_does_not_prove_health(tmp_path: Path) -> None:
    """At a level that opens no seat the data say little, and the reader is told."""
    faint = found_in(tmp_path, runs("healthy", 3, 0.002))
    healthy = found_in(tmp_path, runs("healthy", 3))
    assert healthy.verdict == "healthy" and faint.verdict == "open"
    assert faint.posterior["healthy"] < healthy.posterior["healthy"]
    assert faint.posterior["healthy"] < 0.9
    assert any("open a seat" in words or "shut" in words for words in faint.warnings)


def heavier(text: str) -> str:
    assert 'mass="2.5"' in text
    return text.replace('mass="2.5"', 'mass="6"')


@pytest.mark.slow
def test_another_arm_than_the_model_is_noticed(tmp_path: Path) -> None:
    found = found_in(tmp_path, runs("healthy", 2), edit=heavier)
    assert any("loose gap" in words for words in found.warnings)


@pytest.mark.slow
def test_the_model_is_no_matter_beside_references(tmp_path: Path) -> None:
    beside = (*runs("slide", 2, sound=True), *runs("healthy", 2))
    found = found_in(tmp_path, beside, edit=heavier)
    assert found.fault.kind == "healthy" and found.misfit < 1e-3


def test_references_of_the_sound_arm_are_used_and_not_judged(tmp_path: Path) -> None:
    """Of one the recorder started later."""
    first, second = runs("slide", sound=True)
    later = first.part(slice(150, None))
    found = found_in(tmp_path, (later, second, *runs("slide", 1)))
    assert found.fault.hypothesis == "structural_looseness@link2"
    assert [r.condition for r in found.records] == ["healthy", "healthy", "suspect"]
    assert not found.records[0].probabilities
    assert found.misfit < 0.02


# ------------------------------------------------------------------------- runs as they are


def test_records_say_how_a_run_was_taken(spoilt: Diagnosis) -> None:
    unused, seen = spoilt.records
    assert unused.pose == {"joint1": 0.5} and not unused.probabilities
    noted = runs("slide", 1)[0].pose
    assert noted is not None
    assert seen.pose["joint1"] == pytest.approx(noted["joint1"], abs=0.02)  # its encoder says
    assert seen.pose["joint2"] == noted["joint2"]  # as it was noted, a round number
    notes = " ".join(seen.notes)
    assert "joint1 by" in notes and "joint2_vel is not used: it stands still" in notes
    assert "no sample of" not in notes  # a pause in a column that is not used costs nothing


@pytest.mark.slow
@pytest.mark.parametrize("source", ["commands", "torques"])
def test_pose_and_joint_are_taken_from_the_data_with_a_warning(
    shaken: Recording, source: str
) -> None:
    run = shaken.runs[0]
    bare = replace(run, pose=None, excited=())
    if source == "torques":
        bare = replace(bare, controls={}, torques={"j1": run.controls["s1"]})
    found = of_shaken(shaken, bare)
    assert found.records[0].excited == run.excited
    for words in ("no 'pose' is noted", "no 'excited' is noted", f"taken from the {source}: "):
        assert any(words in warning for warning in found.warnings)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "column", "first"),
    [
        (lambda run: jumping(run, 600, 9.0), "sensor.", 600),
        (lambda run: rows(run, np.r_[0:400, 600 : run.samples]), "sensor.", 600),
        (lambda run: missing(run, "acc", slice(400, 600)), "sensor.acc.x", 600),
        (lambda run: missing(run, "q2", slice(0, 600)), "sensor.q2", 600),
    ],
)
def test_nothing_is_made_up_across_a_pause(
    shaken: Recording, change: Callable[[Run], Run], column: str, first: int
) -> None:
    """The longest piece is used, as if the others had not been recorded, and the reader is told."""
    whole = shaken.runs[0]
    found = of_shaken(shaken, change(whole))
    notes = [note for note in found.records[0].notes if "no sample of" in note]
    assert len(notes) == 1 and column in notes[0] and "are used" in notes[0]
    assert any("no sample of" in warning for warning in found.warnings)
    alone = of_shaken(shaken, rows(whole, np.arange(first, whole.samples)))
    assert found.posterior == pytest.approx(alone.posterior, abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("every", [4, 8])
def test_encoders_slower_than_the_rows_do_not_make_a_sound_arm_loose(
    tmp_path: Path, every: int
) -> None:
    def slow(name: str, values: np.ndarray) -> np.ndarray:
        if name == "tool_acc":
            return values
        time = 1e-3 * np.arange(len(values))
        return resampled(time[::every], values[::every], time, 0.1).values

    usual = found_in(tmp_path, runs("healthy"))
    found = found_in(tmp_path, [with_sensors(run, slow) for run in runs("healthy")])
    assert found.fault.kind == "healthy"
    assert found.probability > usual.probability - 0.1
    assert not any("no sensor of the excited joint" in words for words in found.warnings)


@pytest.mark.slow
def test_two_runs_of_one_name_are_two_runs(shaken: Recording) -> None:
    one, other = shaken.runs
    same = of_shaken(shaken, replace(one, name="run"), replace(other, name="run"))
    assert same.posterior == pytest.approx(of_shaken(shaken, one, other).posterior)


def partial_pose(run: Run) -> Run:
    pose = {joint: q for joint, q in (run.pose or {}).items() if joint != "joint2"}
    return without(replace(run, pose=pose), "joint2_pos")


def moving(run: Run) -> Run:
    moves = np.sin(3 * run.time)
    return with_sensors(run, lambda name, v: v + moves if name == "joint1_pos" else v)


REFUSED: dict[str, tuple[Callable[[Run], Run], str]] = {
    "moving": (moving, "joint1 moves by"),
    "no accelerometer": (lambda r: without(r, "tool_acc"), "no accelerometer of the arm was"),
    "references alone": (lambda r: replace(r, condition="healthy"), "all runs are healthy ref"),
    "no pose": (
        lambda r: without(replace(r, pose=None), "joint1_pos", "joint2_pos", "joint3_pos"),
        "the pose is not known",
    ),
    "partial pose": (partial_pose, "position of joint2 was recorded"),
    "another clock": (
        lambda r: jumping(r, r.samples - 1, 1e6),
        r"run-1\.parquet: column 'time' goes from 1\.99.*row",
    ),
    "pieces too short": (
        lambda r: missing(r, "tool_acc", np.arange(r.samples) % 60 < 12),  # a fifth may miss
        r"no sample of sensor\.tool_acc\.x.*no piece",
    ),
    "times stand still": (
        lambda r: replace(r, time=np.where(np.arange(r.samples) == 5, r.time[4], r.time)),
        "increase strictly",
    ),
    "no time": (
        lambda r: replace(r, time=np.where(np.arange(r.samples) == 5, np.nan, r.time)),
        "increase strictly",
    ),
    "too short": (lambda r: rows(r, np.arange(20)), "a run of 20 samples is too short"),
    "no arm": (lambda r: with_sensors(r, lambda _, v: 1e9 * v), "are corrupt|no arm does"),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_a_run_that_cannot_be_used_is_refused(tmp_path: Path, kind: str) -> None:
    change, words = REFUSED[kind]
    with pytest.raises(InvalidData, match=words) as refused:
        found_in(tmp_path, [change(runs("slide", 1)[0])])
    assert "\n" not in str(refused.value)


def test_actuators_that_are_named_like_joints_do_not_make_a_pose_known(tmp_path: Path) -> None:
    run = without(runs("slide", 1)[0], "joint1_pos", "joint2_pos", "joint3_pos")
    named = {name.replace("motor", "joint"): u for name, u in run.controls.items()}
    with pytest.raises(InvalidData, match="the pose is not known"):
        found_in(
            tmp_path,
            [replace(run, controls=named, pose=None)],
            edit=lambda text: text.replace('name="motor', 'name="joint'),
        )


# ------------------------------------------------------------------------- clocks


def late(values: np.ndarray, seconds: float) -> np.ndarray:
    """A column as a clock notes it that is behind."""
    pad = 200
    ends = ((pad, pad), *((0, 0),) * (values.ndim - 1))
    padded = np.pad(values, ends, mode="edge")
    frequency = np.fft.rfftfreq(len(padded), 1e-3)
    turn = np.exp(-2j * np.pi * frequency * seconds).reshape(-1, *(1,) * (values.ndim - 1))
    moved = np.fft.irfft(np.fft.rfft(padded, axis=0) * turn, len(padded), axis=0)
    return np.asarray(moved[pad:-pad])


def late_commands(run: Run, seconds: float) -> Run:
    return replace(run, controls={n: late(v, seconds) for n, v in run.controls.items()})


def late_tool(run: Run, seconds: float) -> Run:
    return with_sensors(run, lambda name, v: late(v, seconds) if name == "tool_acc" else v)


@pytest.mark.slow
@pytest.mark.parametrize(("moved", "seconds"), [(late_commands, 1e-3), (late_tool, 1e-4)])
def test_clocks_that_are_apart_otherwise_in_every_run_are_no_looseness(
    tmp_path: Path, moved: Callable[[Run, float], Run], seconds: float
) -> None:
    given = [moved(run, s * seconds) for run, s in zip(runs("healthy"), (1, -1), strict=True)]
    found, before = found_in(tmp_path, given), found_in(tmp_path, runs("healthy"))
    assert found.fault.kind == "healthy"
    assert found.probability > before.probability - 0.1


@pytest.mark.slow
def test_a_servo_that_answers_late_is_named(tmp_path: Path) -> None:
    found = found_in(tmp_path, [late_commands(run, -5e-3) for run in runs("healthy")])
    assert any("5.0 ms after what the model makes" in words for words in found.warnings)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "seconds"), [("healthy", 5e-3), ("slide", -5e-3)])
def test_a_late_accelerometer_is_measured_and_named_and_is_no_fault(
    tmp_path: Path, kind: str, seconds: float
) -> None:
    found = found_in(tmp_path, [late_tool(run, seconds) for run in runs(kind, 3)])
    # Accelerometers of the suite are read half a sample early.
    words = "late" if seconds > 0 else "early"
    assert any(f"ms {words}" in each for each in found.open_because)
    assert any("the accelerometers' clock is" in each for each in found.warnings)
    assert not found.settled
    fault = {"healthy": "healthy", "slide": "structural_looseness@link2"}[kind]
    assert found.fault.hypothesis == fault


# ------------------------------------------------------------------------- a hammer

POSES = (
    (np.array([0.3, -0.6, 0.9]), (0.9, 0.2, 0.5)),
    (np.array([-0.5, -0.9, 1.2]), (0.6, 0.3, -0.9)),
    (np.array([0.8, -0.3, 0.6]), (0.5, -0.4, 1.0)),
)


@pytest.fixture(scope="module")
def hammered(tmp_path_factory: pytest.TempPathFactory) -> InstrumentedArm:
    model = written(tmp_path_factory.mktemp("arm"), SERVOED)
    made = read_arm(model, ModelSettings(excitation="hammer")).recording_model.xml
    return read_recorded_arm(written(model.parent, made, "model.xml"))


def struck(arm: InstrumentedArm, loose: tuple[str, tuple[float, ...], float] | None) -> Diagnosis:
    given = [strike(arm, q, along, k, loose=loose) for k, (q, along) in enumerate(POSES, start=1)]
    recording = Recording(folder=arm.path.parent, model_path=arm.path, runs=tuple(given))
    return diagnose(recording, QUICK, plan=False)


@pytest.mark.slow
def test_a_loose_link_is_found_by_a_hammer(hammered: InstrumentedArm) -> None:
    """Along the link: an elastic gear or a bending link moves the tool across it."""
    found = struck(hammered, ("fore", (0.0, 0.0, 1.0), 4e-4))
    assert found.fault.hypothesis == "structural_looseness@fore"
    assert found.probability > 0.95
    assert found.fault.direction is not None
    assert found.fault.direction_half_angle_deg is not None
    off = np.degrees(np.arccos(abs(found.fault.direction[2])))
    assert off < min(found.fault.direction_half_angle_deg, 15.0)
    assert not any("recorded and not used" in warning for warning in found.warnings)


@pytest.mark.slow
def test_a_healthy_arm_that_is_struck_is_not_called_faulty(hammered: InstrumentedArm) -> None:
    found = struck(hammered, None)
    assert found.verdict != "faulty"
    assert found.fault.hypothesis == "healthy" or found.probability < 0.6


# ------------------------------------------------------------------------- sessions, files


def test_a_band_that_the_arm_does_not_have_costs_the_next_pose_alone(shaken: Recording) -> None:
    found = of_shaken(shaken, shaken.runs[0], plan=True, band_high=1.0)
    assert found.next is None and found.verdict == "open"
    assert any("nothing next: a band from" in words for words in found.warnings)
    arm = read_recorded_arm(shaken.model_path).shown
    assert "Take nothing apart yet: the case is open." in diagnosis_text(found, arm)
    decided = replace(found, settled=True, verdict="faulty")
    assert "the case is open" not in diagnosis_text(decided, arm)


@pytest.mark.slow
def test_the_next_band_is_the_one_that_is_asked_for(tmp_path: Path) -> None:
    asked = replace(QUICK, band_low=12.0, band_high=60.0)
    found = found_in(tmp_path, runs("slide", 1), asked, plan=True)
    assert found.next is not None
    assert 12.0 <= found.next.band_hz[0] < found.next.band_hz[1] <= 60.0
    assert found.next.settings["band_high"] == 60.0


@pytest.mark.slow
def test_a_session_asks_measures_and_names_the_link(tmp_path: Path) -> None:
    machine, seen = BlindArm(case("slide")), []
    settings = DiagnoseSettings(poses=3, seconds=1.5)
    ended = find_fault(machine, write_model(tmp_path), settings, most=4, say=seen.append)
    assert ended.named and ended.measurements == len(machine.played) == len(seen)
    assert ended.diagnosis.fault.hypothesis == "structural_looseness@link2"
    assert ended.diagnosis.next is None


def test_a_session_with_a_recording_ends_where_no_more_runs_are_allowed(shaken: Recording) -> None:
    rig = RecordedRig(shaken, ("j1", "j2"))
    ended = find_fault(rig, shaken.model_path, QUICK, most=1)
    assert (ended.measurements, ended.named, rig.left) == (1, False, 1)
    assert ended.diagnosis.records[0].file in ("run-0.parquet", "run-1.parquet")
    with pytest.raises(InvalidSetting, match="most is a number of runs"):
        find_fault(rig, shaken.model_path, QUICK, most=0)


@pytest.mark.slow
def test_the_command_writes_whole_results_and_takes_a_longer_recording(
    shaken: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, out = tmp_path / "recording", tmp_path / "found"
    words = ["diagnose", str(folder), "--out", str(out), "--quiet", "--poses", "2"]

    def cut_short(*_: object, **__: object) -> Path:
        raise KeyboardInterrupt

    for count in (1, 2):
        given = {"model_xml": shaken.model_path, "runs": shaken.runs[:count]}
        write_recording(folder, **given, overwrite=True)
        assert main(words) == 0
        assert len(read_diagnosis(out).records) == count
        assert json.loads((out / "result.json").read_text())["format"] == "loose-diagnosis/1"
        assert not [path.name for path in out.iterdir() if ".part" in path.name]
        if count == 1:  # a result never stands beside the page of another
            monkeypatch.setattr("loose_env.report.diagnosis.write_page", cut_short)
            assert main(words) == 130
            assert not (out / "result.json").exists()
            monkeypatch.undo()


def test_an_interrupted_diagnosis_says_that_it_begins_anew(
    shaken: Recording,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def stopped(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("loose_env.cli.instrument.diagnose", stopped)
    assert main(["diagnose", str(shaken.folder), "--out", str(tmp_path / "found")]) == 130
    said = capsys.readouterr().err
    assert said == "loose diagnose: interrupted; the same command begins anew\n"


# ------------------------------------------------------------------------- settings


def test_settings_of_a_diagnosis_are_those_of_its_next_measurement() -> None:
    limited = DiagnoseSettings(most_tool=2.0, torque_share=0.3, noise_ug=300.0, ground_m=0.1)
    choice = limited.choice()
    shared = {each.name for each in dataclasses.fields(choice)}
    assert shared <= {each.name for each in dataclasses.fields(limited)}
    assert all(getattr(choice, name) == getattr(limited, name) for name in shared - {"rate_hz"})
    assert [DiagnoseSettings().choice(rate).rate_hz for rate in (1e4, 999.8, 500.0)] == [
        1000.0, 1000.0, 500.0,  # the rate asked for unless the recorder is slower
    ]  # fmt: skip
    assert DiagnoseSettings(sure=0.995).sure == 0.995
