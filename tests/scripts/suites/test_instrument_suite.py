"""The instrument suite: what is drawn, played, damaged and graded."""

import json
import math
from pathlib import Path

import mujoco
import numpy as np
import pytest

from loose_env.errors import InvalidData, InvalidSetting
from scripts.suites.blind import numbers_of
from scripts.suites.instrument import cases, grading, run, sensing, session, standins
from scripts.suites.instrument.machines import DESIGNS, STEP
from scripts.suites.instrument.physics import Chances, Fault, Simulated, World
from tests.scripts.suites.null_tool import Null

needs_standins = pytest.mark.skipif(bool(standins.absent()), reason=standins.absent() or "-")
OWN = tuple(name for name in cases.CLASSES if name in DESIGNS)
GANTRY = next(n for n in range(9) if cases.machine_of(n) == "gantry")
NULL = "tests.scripts.suites.null_tool:Null"


class Crashing(Null):
    """A tool that plans and then fails."""

    def diagnose(self, folder: Path, variant: str = "") -> dict:
        raise RuntimeError("no idea")


class Short(Null):
    """One run of three levels of 0.6 s; enough after the second level."""

    def plan(self, folder: Path) -> dict:
        plan = super().plan(folder)
        whole = plan["runs"][0]
        part = whole["command"][: round(0.6 * plan["rate_hz"])]
        names = ("low", "middle", "high")
        runs = [{**whole, "name": n, "level": n, "command": part} for n in names]
        return {**plan, "runs": runs}

    def enough(self, folder: Path) -> bool:
        index = json.loads((folder / "recording" / "recording.json").read_text())
        return len(index["runs"]) == 2


def truth_of(case: cases.Case, opened: bool = True) -> dict:
    names = {f.name: opened for f in case.faults}
    return json.loads(json.dumps({**case.truth(), "opened": names, "shaken": 30.0}))


def drawn_of(role: str, kind: str = "") -> cases.Case:
    found = (cases.drawn(n) for n in range(400) if not cases.skipped(n))
    return next(c for c in found if c.role == role and kind in (c.kind, ""))


# ---------------------------------------------------------------------------------- draws


def test_development_numbers_have_no_class_that_is_kept_for_judging():
    seen = {cases.machine_of(n) for n in range(1000)}
    assert seen == set(cases.CLASSES) - {"palletiser", "seven"}
    assert {cases.machine_of(n) for n in range(10_000, 10_100)} == set(cases.CLASSES)


def test_judged_cases_hang_on_their_phrase():
    with pytest.raises(InvalidSetting, match="--phrase"):
        cases.drawn(10_000)
    numbers = [n for n in range(10_000, 10_030) if not cases.skipped(n)]
    one, other = ([cases.drawn(n, p).name for n in numbers] for p in ("a", "b"))
    assert one == [cases.drawn(n, "a").name for n in numbers]
    assert not set(one) & set(other)


def test_roles_come_in_their_shares():
    numbers = [n for n in range(10_000, 11_000) if not cases.skipped(n)]
    drawn = [cases.drawn(n, "shares") for n in numbers]
    share = {r: np.mean([c.role == r for c in drawn]) for r in ("healthy", "one", "two")}
    assert share["healthy"] == pytest.approx(0.45, abs=0.06)
    assert share["two"] == pytest.approx(0.10, abs=0.04)
    kinds = {c.kind for c in drawn if c.role == "healthy"}
    assert kinds == set(cases.HEALTHY)
    assert all(len({f.name for f in c.faults}) == 2 for c in drawn if c.role == "two")
    seats = [f for c in drawn for f in c.faults if f.direction is not None]
    assert 0.05 < np.mean([f.preload > 0 for f in seats]) < 0.2


def test_numbers_that_are_no_cases_are_refused():
    assert numbers_of(["3", "7-9"]) == [3, 7, 8, 9]
    with pytest.raises(InvalidSetting, match="no case"):
        numbers_of(["9-7"])


@pytest.mark.parametrize("name", OWN)
def test_users_have_a_model_with_what_recordings_name(name):
    model = mujoco.MjModel.from_xml_string(cases.nominal_xml(name))
    sheet = cases.SHEETS[name]
    assert [model.joint(i).name for i in range(model.njnt)] == list(sheet.joints)
    assert {model.sensor(i).name for i in range(model.nsensor)} == {
        "tool_acc",
        *(f"{joint}_pos" for joint in sheet.joints),
    }
    assert model.site("tool").bodyid[0] == model.body(sheet.bodies[-1]).id


# ---------------------------------------------------------------------------------- physics


def shake(name: str, seconds: float, amplitude: float) -> np.ndarray:
    sheet = cases.SHEETS[name]
    time = np.arange(round(seconds * 1000)) / 1000
    ways = 2 * np.pi * np.array([7, 9, 11, 5, 13, 15, 17])[: len(sheet.joints)]
    size = amplitude * np.array(sheet.acceleration) / ways**2
    return size * (1 - np.cos(np.outer(time, ways))) * np.clip(time / 0.1, 0, 1)[:, None]


@pytest.mark.parametrize("name", ["gantry", "palletiser"])
def test_a_machine_follows_its_commands_and_a_loose_seat_knocks(name):
    sheet = cases.SHEETS[name]
    pose = (np.array(sheet.low) + np.array(sheet.high)) / 2
    command = pose + shake(name, 0.5, 0.7)
    fault = Fault(
        kind="structural_looseness", at=sheet.bodies[1], index=1, clearance=2e-4,
        direction=(0.0, 1.0, 0.0), friction=sheet.friction[0],
    )  # fmt: skip
    high = []
    for faults in ((), (fault,)):
        played = Simulated(DESIGNS[name], Chances(seed=(1,), day=0), faults).play(
            pose, command, 1000.0, 0
        )
        assert played.motor.max(axis=0) == pytest.approx(command.max(axis=0), abs=0.01)
        assert played.acceleration[0] @ played.acceleration[0] == pytest.approx(9.81**2, rel=0.1)
        high.append(np.diff(played.acceleration, 2, axis=0).std())
    assert played.travel[fault.name] > 0.8
    assert high[1] > 1.5 * high[0]


@pytest.mark.parametrize("name", ["cobot", "seven", "welder"])
def test_each_way_of_control_holds_a_pose(name):
    sheet = cases.SHEETS[name]
    pose = (np.array(sheet.low) + np.array(sheet.high)) / 2
    command = np.tile(pose if sheet.command == "position" else 0 * pose, (300, 1))
    machine = Simulated(DESIGNS[name], Chances(seed=(1,), day=0))
    played = machine.play(pose, command, 1000.0, 0)
    assert played.motor == pytest.approx(np.tile(pose, (len(played.motor), 1)), abs=0.02)
    assert np.abs(np.diff(played.motor, axis=0)).max() < 1e-3


def test_a_preload_keeps_a_seat_shut():
    sheet = cases.SHEETS["gantry"]
    pose = (np.array(sheet.low) + np.array(sheet.high)) / 2
    fault = Fault(
        kind="structural_looseness", at="ram", index=2, clearance=2e-4, preload=2000.0,
        direction=(0.0, 1.0, 0.0), friction=5.0,
    )  # fmt: skip
    machine = Simulated(DESIGNS["gantry"], Chances(seed=(1,), day=0), (fault,))
    played = machine.play(pose, pose + shake("gantry", 0.4, 0.7), 1000.0, 0)
    assert played.travel[fault.name] < cases.OPENED


def test_another_day_has_the_same_machine():
    one, other = (Simulated(DESIGNS["gantry"], Chances(seed=(4,), day=d)) for d in (0, 1))
    assert np.allclose(one.model.body_mass, other.model.body_mass)
    assert np.all(one._fc != other._fc)
    assert one._k == pytest.approx(other._k, rel=0.04)
    assert not np.allclose(one.model.site_quat, other.model.site_quat)


def test_logs_have_clocks_of_their_own():
    sheet, steps = cases.SHEETS["gantry"], round(2 / STEP)
    time = np.arange(steps) * STEP
    acceleration = np.stack([np.sin(2 * np.pi * 10 * time)] * 3, axis=1)
    motor = np.stack([np.sin(2 * np.pi * 10 * np.arange(2000) / 1000)] * 3, axis=1)
    played = session.sensing.Played(
        acceleration=acceleration, motor=motor, link=motor, torque=motor, travel={}
    )
    log = sensing.logged(played, sheet, World(), Chances(seed=(3,), day=0), 0)
    columns = sensing.columns_of(log, sheet)
    assert np.diff(columns["time"]) == pytest.approx(1 / sheet.sensor.rate_hz)
    wave = np.exp(-2j * np.pi * 10 * columns["time"])
    phase = np.angle((columns["sensor.tool_acc.x"] @ wave) / (columns["sensor.x_pos"] @ wave))
    assert 2e-4 < abs(phase) / (2 * np.pi * 10) < 4e-3


# ---------------------------------------------------------------------------------- sessions


def test_a_session_is_played_until_the_tool_has_enough(tmp_path):
    case, tool = cases.drawn(GANTRY), Short()
    session.lay_out(case, tmp_path)
    plan = tool.plan(tmp_path)
    session.pack(plan, tmp_path / "plan.npz")
    again = session.unpack(tmp_path / "plan.npz")
    assert session.plan_hash(again) == session.plan_hash(plan)
    truth = session.play_case(case, again, tmp_path / "case", tool.enough)
    for part in ("recording", "reference"):
        index = json.loads((tmp_path / "case" / part / "recording.json").read_text())
        assert [each["file"] for each in index["runs"]] == ["low.parquet", "middle.parquet"]
    columns = sensing.read_run(tmp_path / "case" / "recording", "low")
    assert {"time", "sensor.x_pos", "torque.x", "sensor.tool_acc.z"} <= set(columns)
    assert truth["shaken"] == pytest.approx(1.2)
    alone = session.without_reference(tmp_path / "case", tmp_path / "alone")
    assert {each.name for each in alone.iterdir()} == {
        "model.xml", "session.json", "recording", "raw"
    }  # fmt: skip


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"pose": [9.0, 0.0, 0.0]}, "range|pose"),
        ({"command": np.full((100, 3), np.nan)}, "not finite"),
        ({"command": np.zeros((100, 2))}, "3 joints"),
    ],
)
def test_plans_that_a_controller_would_not_take_are_refused(tmp_path, change, words):
    case = cases.drawn(GANTRY)
    session.lay_out(case, tmp_path)
    plan = Null().plan(tmp_path)
    session.check_plan(plan, case.sheet)
    plan["runs"][0] = {**plan["runs"][0], **change}
    with pytest.raises(InvalidData, match=words):
        session.check_plan(plan, case.sheet)


@pytest.mark.parametrize("kind", sensing.DAMAGES)
def test_each_damage_shows_in_the_files(kind):
    sheet, time = cases.SHEETS["gantry"], np.arange(2000) / 1000
    rng = np.random.default_rng(0)
    run_ = {"time": time, **{f"sensor.{j}_pos": time * (i + 1) for i, j in enumerate("xyz")}}
    run_ |= {f"sensor.tool_acc.{a}": 9.81 + rng.standard_normal(2000) for a in "xyz"}
    runs = [{key: values.copy() for key, values in run_.items()}]
    sensing.DAMAGES[kind](runs, sheet, rng)
    assert any(not np.array_equal(runs[0][key], values) for key, values in run_.items())
    assert {len(values) for values in runs[0].values()} == {500 if kind == "cut" else 2000}


# ---------------------------------------------------------------------------------- grading


def answer(verdict: str, *places: tuple, **rest: object) -> dict:
    named = [{"kind": k, "at": a, "probability": 0.5, "direction": d} for k, a, d in places]
    return {"verdict": verdict, "settled": True, "places": named, "remedy": "none", **rest}


def test_marks_of_a_seat():
    case = drawn_of("one", "structural_looseness")
    fault, truth = case.faults[0], truth_of(case)
    x, y, z = fault.direction
    right = grading.grade(answer("loose", (fault.kind, fault.at, [-x, -y, -z])), truth)
    assert right["loose"] and right["first"] and right["near"] and not right["wrong"]
    assert right["direction"] == pytest.approx(0, abs=1e-3)
    far = case.sheet.joints[-1 if fault.index < 2 else 0]
    wrong = grading.grade(answer("loose", ("backlash", far, None)), truth)
    assert wrong["wrong"] and not wrong["first"]
    assert grading.grade(answer("tight"), truth)["wrong"]
    shut = truth_of(case, opened=False)
    assert not grading.grade(answer("tight"), shut)["wrong"]
    assert grading.grade(answer("tight"), shut)["tight_shut"]
    told = answer("open", tested={fault.name: "not tested"})
    assert not grading.grade(told, shut)["tight_shut"]


def test_a_rocking_base_is_no_false_alarm_at_the_base():
    case = drawn_of("healthy", "base")
    truth = truth_of(case)
    at_base = answer("loose", ("structural_looseness", case.sheet.base, None))
    assert not grading.grade(at_base, truth)["alarm"]
    at_link = answer("loose", ("structural_looseness", case.sheet.bodies[1], None))
    assert grading.grade(at_link, truth)["alarm"]


@pytest.mark.parametrize(
    "said",
    [
        {},
        answer("perhaps"),
        answer("loose", ("dirt", "arm", None)),
        answer("loose", ("backlash", "x", [1.0, math.nan, 0.0])),
    ],
)
def test_answers_that_do_not_keep_to_the_protocol_are_unfit(said):
    assert grading.unfit(said)


def test_tables_have_every_line():
    found = [cases.drawn(n) for n in range(60) if not cases.skipped(n)]
    rows = []
    for case in found:
        truth = truth_of(case)
        marks = grading.grade(answer("open", remarks=["x"]), truth)
        rows.append({
            "number": case.number, "case": case.name, "machine": case.machine,
            "role": case.role, "kind": case.kind, "damage": "cut", "shaken": 30.0,
            "alone": marks, "reference": marks,
        })  # fmt: skip
    words = grading.table(rows)
    assert "Without a reference" in words and "With a reference" in words
    assert all(f"| {line} |" in words for line, _ in grading.LINES)
    assert "| cut |" in grading.damaged_table(rows)
    assert "open" in grading.words_of(rows[0])
    assert grading.variants_table({"a": rows, "b": rows[:9]}).count("9 cases") == 2


def test_months_tell_when_the_first_alarm_came():
    alarms = [False] * 7 + [True] * 5
    rows = [{"role": "one", "alarms": alarms, "unanswered": 0}]
    assert "median 2.0, most 2" in grading.months_table(rows)


def test_a_growing_fault_begins_in_its_month():
    number = next(
        n for n in range(200) if cases.machine_of(n) in DESIGNS
        and cases.drawn(n, "", "months").role == "one"
    )  # fmt: skip
    case = cases.drawn(number, "", "months")
    sizes = [[f.clearance for f in case.in_month(m).faults] for m in (5, 6, 12)]
    assert sizes[0] == [] and 0 < sizes[1][0] < sizes[2][0]
    assert sizes[2][0] == pytest.approx(case.faults[0].clearance)


# ---------------------------------------------------------------------------------- commands


def test_tools_are_checked():
    assert isinstance(run.tool_of(NULL), Null)
    with pytest.raises(InvalidSetting, match="three-poses"):
        run.tool_of("nothing")
    with pytest.raises(InvalidSetting, match="diagnose"):
        run.tool_of("pathlib:Path")


def test_each_judged_case_needs_a_phrase(tmp_path, capsys):
    with pytest.raises(SystemExit, match="--phrase"):
        run.main(["--numbers", "10003", "--tool", NULL, "--out", str(tmp_path)])


@pytest.mark.slow
def test_a_command_plays_judges_resumes_and_shows(tmp_path, capsys):
    words = ["--numbers", str(GANTRY), "--blind", str(tmp_path / "blind")]
    null = [*words, "--tool", NULL, "--out", str(tmp_path / "null")]
    run.main([*null, "--ablate"])
    printed = capsys.readouterr().out
    assert all(f"| {name} | none | 0/1 |" in printed for name in ("as shipped", "silent"))
    run.main([*null, "--show"])
    assert "| found, of faults that opened |" in capsys.readouterr().out
    bad = [*words, "--tool", f"{__name__}:Crashing", "--out", str(tmp_path / "bad")]
    run.main(bad)
    rows = (tmp_path / "bad" / "rows.jsonl").read_text().splitlines()
    assert "no idea" in json.loads(rows[0])["error"]
    assert len(list((tmp_path / "blind" / "truth").iterdir())) == 1


@pytest.mark.slow
def test_others_enter_with_files(tmp_path, capsys):
    number = next(n for n in range(10_000, 10_009) if cases.machine_of(n) == "gantry")
    suite, words = tmp_path / "suite", ["--numbers", str(number), "--phrase", "kept back"]
    words += ["--tool", f"{__name__}:Short", "--out", str(tmp_path / "out")]
    run.main([*words, "--make", str(suite)])
    (name,) = json.loads((suite / "protocol.json").read_text())["cases"]
    (tmp_path / "answers").mkdir()
    both = {way: answer("tight") for way in grading.WAYS}
    (tmp_path / "answers" / f"{name}.json").write_text(json.dumps(both))
    given = [*words, "--blind", str(suite), "--answers", str(tmp_path / "answers")]
    run.main(given)
    assert "alone: tight settled" in capsys.readouterr().out
    sealed = suite / "truth" / f"{name}.json"
    sealed.write_text(sealed.read_text().replace("gantry", "cobot"))
    with pytest.raises(SystemExit, match="commitments"):
        run.main([*given, "--afresh"])


@pytest.mark.slow
@needs_standins
@pytest.mark.parametrize("name", list(standins.SHEETS))
def test_stand_ins_are_played(name, tmp_path):
    number = next(
        n for n in range(200)
        if cases.machine_of(n) == name and cases.drawn(n).kind == "structural_looseness"
    )  # fmt: skip
    case = cases.drawn(number)
    session.lay_out(case, tmp_path / "plan")
    plan = Null().plan(tmp_path / "plan")
    plan = {**plan, "runs": plan["runs"][:1]}
    truth = session.play_case(case, plan, tmp_path / "case", None)
    assert set(truth["opened"]) == {f.name for f in case.faults}
    columns = sensing.read_run(tmp_path / "case" / "recording", "run-01")
    assert all(np.isfinite(values).all() for values in columns.values())
