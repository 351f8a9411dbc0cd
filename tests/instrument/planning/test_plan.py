"""The next step of a session: pose, joint and signal, and the files they are written to."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from loose_env.errors import InvalidData, InvalidSetting, UnknownName
from loose_env.instrument.model.instrumented_arm import read_arm
from loose_env.instrument.planning.files import signal_files
from loose_env.instrument.planning.files.plan_files import PlanFiles, write_plan
from loose_env.instrument.planning.next_measurement import NextSettings
from loose_env.instrument.planning.plan import Plan, next_for, plan
from loose_env.instrument.result import Diagnosis, Fault, RecordSeen
from loose_env.instrument.settings.arm_and_plan import ModelSettings, PlanSettings
from loose_env.instrument.settings.motion import MotionSettings
from loose_env.recording import read_parquet, read_recording, write_csv
from loose_env.report import plan_commands
from tests.instrument.arms.plan_arms import MOTORS, SERVOED, URDF, written
from tests.instrument.arms.playing import play

FEW = NextSettings(poses=8, seconds=1.2)


@pytest.fixture(scope="module")
def servoed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("servoed"), SERVOED)


@pytest.fixture(scope="module")
def motors(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("motors"), MOTORS)


@pytest.fixture(scope="module")
def first(servoed: Path) -> Plan:
    return plan(servoed, choice=FEW)


def known(made: Plan, **shares: float) -> Diagnosis:
    """A diagnosis that holds some hypotheses for probable, after one record in the plan's pose."""
    names = made.arm.hypotheses
    rest = (1 - sum(shares.values())) / (len(names) - len(shares))
    by_name = {name.partition("@")[2] + "_" + name[:1]: name for name in names}
    posterior = dict.fromkeys(names, rest)
    for short, p in shares.items():
        posterior[by_name.get(short, short)] = p
    best = max(posterior, key=lambda name: posterior[name])
    kind, _, where = best.partition("@")
    fault = Fault(kind=kind, where=where or None)  # type: ignore[arg-type]
    record = RecordSeen(
        file="run-01.csv",
        pose=dict(made.next.pose),
        excited=made.next.joints,
        condition="suspect",
        probabilities=posterior,
        direction_tool=(0.6, 0.0, 0.8),
        half_angle_deg=12.0,
    )
    return Diagnosis(
        fault=fault, probability=posterior[best], posterior=posterior, records=(record,)
    )


@pytest.mark.parametrize("joint", ["pan", "lift", "elbow"])
def test_what_is_played_on_servos_does_what_the_plan_says(servoed: Path, joint: str) -> None:
    made = plan(servoed, choice=FEW, own=PlanSettings(joint=joint, hold_s=1.5))
    signal, did = made.signals[0], play(made, step=5e-5)
    assert did.tool_rms == pytest.approx(signal.tool_rms, rel=0.05)
    assert did.joint_rms == pytest.approx(signal.joint_rms, rel=0.05)
    allowed = FEW.torque_share * np.array(made.arm.nominal.torque_limits)
    assert (signal.torque_peaks <= allowed * 1.001).all()
    assert (did.torque_peaks <= allowed * 1.03).all()
    assert did.travel == pytest.approx(signal.travel, rel=0.15, abs=2e-5)
    assert did.standing < 1e-3 * did.tool_rms  # it holds its pose before the noise begins
    assert did.held_at == pytest.approx(made.pose, abs=1e-5)


def test_motors_are_given_torque_that_holds_the_pose_too(motors: Path) -> None:
    made = plan(motors, choice=FEW, own=PlanSettings(joint="lift"))
    did = play(made, step=5e-5)
    assert did.tool_rms == pytest.approx(made.signals[0].tool_rms, rel=0.05)
    assert did.standing < 1e-3 * did.tool_rms
    held = made.signals[0].commands["m2"]
    assert held[0] != 0  # gravity
    assert (held == held[0]).all()
    assert np.abs(made.signals[0].commands["m1"]).max() <= FEW.torque_share


def test_the_noise_swells_and_stays_in_its_band(first: Plan) -> None:
    signal = first.signals[0]
    drive = first.arm.drives[first.arm.joints.index(signal.joint)]
    assert drive is not None
    command = signal.commands[drive.actuator]
    start, end = signal.steady_s
    assert start == pytest.approx(0.75)
    assert end - start == pytest.approx(FEW.seconds)
    assert (command[signal.time < 0.5] == command[0]).all()
    noise = command[(signal.time >= start) & (signal.time < end)] - command[0]
    power = np.abs(np.fft.rfft(noise)) ** 2
    frequency = np.fft.rfftfreq(len(noise), 1e-3)
    low, high = first.next.band_hz
    outside = (frequency < low - 1) | (frequency > high + 1)
    assert power[outside].sum() < 1e-6 * power.sum()
    steps = np.abs(np.diff(command))
    assert steps.max() < 1.5 * np.abs(noise).max()  # no jump at either end of the ramps


def test_the_same_seed_gives_the_same_plan(servoed: Path, first: Plan) -> None:
    again = plan(servoed, choice=FEW)
    assert again.next == first.next
    drive = first.signals[0].commands
    assert all((again.signals[0].commands[name] == u).all() for name, u in drive.items())
    other = plan(servoed, choice=replace(FEW, seed=1))
    assert not np.array_equal(other.signals[0].commands["lift_servo"], drive["lift_servo"]) or (
        other.next.joints != first.next.joints or other.next.pose != first.next.pose
    )


def test_no_pose_touches_the_ground_or_leaves_the_ranges(servoed: Path) -> None:
    machine = read_arm(servoed)
    assert machine.collisions.known
    assert machine.collisions.touch([0.0, 1.2, 0.8])  # the tool through the floor
    for seed in range(4):
        chosen = next_for(machine, settings=replace(FEW, seed=seed, poses=4))
        pose = np.array([chosen.pose[name] for name in machine.joints])
        assert not machine.collisions.touch(pose)
        assert machine.nominal.within_ranges(pose).all()


def test_a_second_plan_moves_on_to_tell_two_links_apart(servoed: Path, first: Plan) -> None:
    so_far = known(first, post_s=0.45, fore_s=0.45)
    made = plan(servoed, so_far, choice=FEW)
    assert made.next.pose != first.next.pose
    assert "structural_looseness@post" in made.next.reason
    assert "structural_looseness@fore" in made.next.reason
    one = made.expected["structural_looseness@post"].direction_tool
    other = made.expected["structural_looseness@fore"].direction_tool
    assert one is not None
    assert other is not None
    cosine = abs(float(np.dot(one, other)))
    assert np.degrees(np.arccos(min(cosine, 1.0))) > 30


def test_a_plan_takes_what_the_diagnosis_wants_next(servoed: Path, first: Plan) -> None:
    chosen = replace(FEW, seed=7, seconds=1.0)
    fast = MotionSettings(max_speed_rad_s=(1e3,))
    wanted = next_for(first.arm, settings=chosen, motion=fast)
    so_far = replace(known(first, fore_s=0.5), next=wanted)
    for choice in (None, chosen):
        made = plan(servoed, so_far, choice=choice, motion=fast)
        assert made.next.pose == wanted.pose
        assert made.next.joints == wanted.joints
        assert made.next.seconds == 1.0
        assert made.settings["seconds"] == 1.0
        assert not any("asks for next" in warning for warning in made.warnings)


def test_what_a_diagnosis_wants_next_is_not_taken_through_the_floor(
    servoed: Path, first: Plan
) -> None:
    """The recording's model has no meshes, and knows of fewer collisions than the arm's own."""
    pose = {"pan": 0.0, "lift": 1.2, "elbow": 0.8}
    asked = replace(first.next, pose=pose)
    assert first.arm.collisions.touch(list(pose.values()))
    made = plan(servoed, replace(known(first, fore_s=0.5), next=asked), choice=FEW)
    assert made.next.pose != pose
    assert not first.arm.collisions.touch(made.pose)
    assert any("its pose is not taken" in warning for warning in made.warnings)


def test_the_next_command_has_the_options_that_the_session_began_with(servoed: Path) -> None:
    made = plan(
        servoed,
        arm=ModelSettings(payload_kg=0.5, payload_at_m=(0.0, 0.0, 0.1), tool="tool"),
        choice=replace(FEW, most_tool=5.0),
        own=PlanSettings(joint="lift", hold_s=0.7),
    )
    command = plan_commands(made, "DIR")[-1]
    for words in (
        "--tool tool",
        "--payload-kg 0.5",
        "--payload-at-m 0 0 0.1",
        "--most-tool 5",
        "--seconds 1.2",
        "--hold-s 0.7",
    ):
        assert words in command
    assert "--joint" not in command
    assert "--noise-ug" not in command


def test_several_joints_are_played_in_turn(servoed: Path) -> None:
    made = plan(servoed, choice=replace(FEW, in_turn=2))
    assert len(made.signals) == len(set(made.next.joints)) == 2


def test_a_settled_diagnosis_is_said_to_need_no_more(servoed: Path, first: Plan) -> None:
    """One run settles nothing, however sure."""
    sure = known(first, fore_s=0.99)
    made = plan(servoed, sure, choice=FEW)
    assert not any("only confirm" in warning for warning in made.warnings)
    made = plan(servoed, replace(sure, settled=True), choice=FEW)
    assert any("settled" in w and "only confirm" in w for w in made.warnings)


def test_a_diagnosis_of_another_model_is_refused(servoed: Path, motors: Path, first: Plan) -> None:
    with pytest.raises(InvalidData, match=r"another model.*structural_looseness@post"):
        plan(motors, known(first, fore_s=0.5), choice=FEW)


@pytest.mark.parametrize(
    ("own", "choice", "kind", "words"),
    [
        (PlanSettings(joint="knee"), FEW, UnknownName, r"'knee'.*pan, lift, elbow"),
        (PlanSettings(pose_deg=(1.0, 2.0)), FEW, InvalidSetting, r"each of pan, lift, elbow"),
        (PlanSettings(pose_deg=(0.0, 170.0, 0.0)), FEW, InvalidSetting, r"lift at 170.*-120"),
        (PlanSettings(), replace(FEW, rate_hz=60.0), InvalidSetting, r"60 Hz allows up to 24 Hz"),
    ],
)
def test_what_cannot_be_planned_is_refused(
    servoed: Path, own: PlanSettings, choice: NextSettings, kind: type[Exception], words: str
) -> None:
    with pytest.raises(kind, match=words):
        plan(servoed, choice=choice, own=own)


def test_a_urdf_without_actuators_or_meshes_gets_motors_and_its_flange(tmp_path: Path) -> None:
    made = plan(written(tmp_path, URDF, "plain.urdf"), choice=FEW)
    assert made.arm.report.tool == "flange"
    assert set(made.signals[0].commands) == {"j1_motor", "j2_motor"}
    assert any("torque motors are added" in warning for warning in made.warnings)


def test_a_payload_takes_torque_to_hold(servoed: Path) -> None:
    bare, loaded = read_arm(servoed), read_arm(servoed, ModelSettings(payload_kg=2.0))
    pose = [0.0, 0.0, 0.0]
    from loose_env.arms import LinearArm

    more = (
        LinearArm(loaded.nominal).at(pose).gravity_torque
        - LinearArm(bare.nominal).at(pose).gravity_torque
    )
    assert np.abs(more[1]) == pytest.approx(2.0 * 9.81 * 0.75, rel=1e-6)
    with pytest.raises(InvalidSetting, match="zero or more kg"):
        read_arm(servoed, ModelSettings(payload_kg=-1.0))


class TestFiles:
    def test_a_measured_run_makes_the_folder_a_recording(self, first: Plan, tmp_path: Path) -> None:
        files = PlanFiles(tmp_path / "session", first.arm.recording_model.xml)
        write_plan(files, first)
        run = files.recording / files.next_names(1)[0]
        write_csv(run, play(first).columns)
        recording = read_recording(files.recording)
        assert recording.runs[0].excited == first.next.joints
        assert recording.runs[0].pose == pytest.approx(first.next.pose)

    def test_the_second_plan_keeps_the_runs_measured(self, first: Plan, tmp_path: Path) -> None:
        files = PlanFiles(tmp_path, first.arm.recording_model.xml)
        write_plan(files, first)
        write_plan(PlanFiles(tmp_path, first.arm.recording_model.xml), first)  # nothing measured
        listed = json.loads((files.recording / "recording.json").read_text("utf-8"))
        assert [run["file"] for run in listed["runs"]] == ["run-01.csv", "repeat-01.csv"]
        write_csv(files.recording / "run-01.csv", play(first).columns)
        again = PlanFiles(tmp_path, first.arm.recording_model.xml)
        write_plan(again, first)
        listed = json.loads((files.recording / "recording.json").read_text("utf-8"))
        assert [run["file"] for run in listed["runs"]] == [
            "run-01.csv",
            "run-02.csv",
            "repeat-01.csv",
        ]

    def test_both_tables_hold_the_same_signal(self, first: Plan, tmp_path: Path) -> None:
        write_plan(PlanFiles(tmp_path, first.arm.recording_model.xml), first)
        text = np.genfromtxt(tmp_path / "signal.csv", delimiter=",", names=True)
        table = read_parquet(tmp_path / "signal.parquet", "signal.parquet", lambda header: None)
        for name, values in table.columns.items():
            assert (text[name.replace(".", "")] == values).all()
        assert list(table.columns) == [
            "time",
            "ctrl.pan_servo",
            "ctrl.lift_servo",
            "ctrl.elbow_servo",
        ]

    def test_the_plan_says_all_in_json(self, first: Plan, tmp_path: Path) -> None:
        write_plan(PlanFiles(tmp_path, first.arm.recording_model.xml), first)
        whole = json.loads((tmp_path / "plan.json").read_text("utf-8"))
        assert whole["format"] == "loose-plan/1"
        assert set(whole["pose"]) == {"pan", "lift", "elbow"}
        assert whole["signals"][0]["actuator"].endswith("_servo")
        assert set(whole["expected"]) == set(first.arm.hypotheses)
        assert whole["seed"] == 0

    def test_a_plan_cut_short_is_no_plan_and_is_written_anew(
        self, first: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        write_plan(PlanFiles(tmp_path, first.arm.recording_model.xml), first)

        def full(path: Path, columns: object) -> None:
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(signal_files, "write_parquet", full)
        with pytest.raises(OSError, match="No space"):
            write_plan(PlanFiles(tmp_path, first.arm.recording_model.xml), first)
        assert not (tmp_path / "plan.json").exists()  # nobody takes the halves for a plan
        monkeypatch.undo()
        write_plan(PlanFiles(tmp_path, first.arm.recording_model.xml), first)
        assert (tmp_path / "plan.json").exists()

    def test_files_of_others_are_not_overwritten(self, first: Plan, tmp_path: Path) -> None:
        (tmp_path / "signal.csv").write_text("mine", encoding="utf-8")
        with pytest.raises(InvalidSetting, match=r"signal\.csv"):
            PlanFiles(tmp_path, first.arm.recording_model.xml)
        (tmp_path / "plan.json").write_text("{}", encoding="utf-8")
        with pytest.raises(InvalidSetting, match=r"plan\.json"):
            PlanFiles(tmp_path, first.arm.recording_model.xml)
        file = tmp_path / "file"
        file.write_text("", encoding="utf-8")
        with pytest.raises(InvalidSetting, match="is a file"):
            PlanFiles(file, first.arm.recording_model.xml)

    def test_only_signals_that_the_earlier_plan_lists_are_removed(
        self, servoed: Path, first: Plan, tmp_path: Path
    ) -> None:
        two = plan(servoed, choice=replace(FEW, in_turn=2))
        xml = first.arm.recording_model.xml
        write_plan(PlanFiles(tmp_path, xml), two)
        mine = [tmp_path / "signal-measured.csv", tmp_path / "signal-3.parquet"]
        for path in mine:
            path.write_text("mine", encoding="utf-8")
        write_plan(PlanFiles(tmp_path, xml), first)
        assert not (tmp_path / "signal-2.csv").exists()
        assert not (tmp_path / "signal-2.parquet").exists()
        assert all(path.read_text("utf-8") == "mine" for path in mine)

    def test_a_further_signal_does_not_overwrite_a_file_of_others(
        self, servoed: Path, first: Plan, tmp_path: Path
    ) -> None:
        xml = first.arm.recording_model.xml
        write_plan(PlanFiles(tmp_path, xml), first)
        before = (tmp_path / "plan.json").read_text("utf-8")
        (tmp_path / "signal-2.csv").write_text("mine", encoding="utf-8")
        two = plan(servoed, choice=replace(FEW, in_turn=2))
        with pytest.raises(InvalidSetting, match=r"signal-2\.csv.*no plan lists it"):
            write_plan(PlanFiles(tmp_path, xml), two)
        assert (tmp_path / "signal-2.csv").read_text("utf-8") == "mine"
        assert (tmp_path / "plan.json").read_text("utf-8") == before

    def test_a_changed_plan_makes_no_other_file_be_removed(
        self, first: Plan, tmp_path: Path
    ) -> None:
        xml = first.arm.recording_model.xml
        out = tmp_path / "session"
        write_plan(PlanFiles(out, xml), first)
        others = [tmp_path / "precious.csv", out / "signal-x.csv"]
        for path in others:
            path.write_text("mine", encoding="utf-8")
        whole = json.loads((out / "plan.json").read_text("utf-8"))
        for listed in ("../precious.csv", str(others[0]), "signal-x.csv", 7, None, ["a"]):
            whole["signals"] = [{"csv": listed}, listed]
            (out / "plan.json").write_text(json.dumps(whole), encoding="utf-8")
            write_plan(PlanFiles(out, xml), first)
            assert all(path.exists() for path in others)

    def test_a_session_of_another_model_is_refused(
        self, first: Plan, motors: Path, tmp_path: Path
    ) -> None:
        write_plan(PlanFiles(tmp_path, first.arm.recording_model.xml), first)
        with pytest.raises(InvalidData, match="another model"):
            PlanFiles(tmp_path, read_arm(motors).recording_model.xml)


def test_a_slow_recorder_gets_a_lower_band(servoed: Path) -> None:
    made = plan(servoed, choice=replace(FEW, rate_hz=300.0))
    assert made.next.band_hz[1] <= 0.4 * 300.0
    assert np.diff(made.signals[0].time) == pytest.approx(1 / 300.0)


def test_no_joint_is_told_what_its_actuator_does_not_take(tmp_path: Path) -> None:
    """A servo that gives way has to be told more than the pose, which its range may not hold."""
    narrow = SERVOED.replace('kp="900"', 'kp="200"').replace("-2.2 2.2", "-0.35 2.2")
    model = written(tmp_path, narrow)
    with pytest.raises(InvalidData, match=r"lift_servo would have to be told .* from -0.35 to 2.2"):
        plan(model, choice=FEW, own=PlanSettings(joint="pan", pose_deg=(0.0, -20.0, 60.0)))
    made = plan(model, choice=FEW, own=PlanSettings(joint="pan"))
    told = made.signals[0].commands["lift_servo"]
    assert told.min() >= -0.35
    assert told.max() <= 2.2
