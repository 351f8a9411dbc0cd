"""The suite runs, resumes, keeps the truth sealed, and turns what goes wrong into rows."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

pytest.importorskip("numba")
pytest.importorskip("joblib")

from loose_env.errors import InvalidSetting
from loose_env.gap import read_result
from loose_env.recording import Run, write_recording
from scripts.suites.gap import run as suite
from scripts.suites.gap.cases import full_list, name_of, numbers_of, quick_list, role_of
from scripts.suites.gap.effects import CATALOGUE
from scripts.suites.gap.grading import LISTED, PARAMETERS, Grade, grade
from scripts.suites.gap.run import (
    METHODS,
    Folders,
    grade_of,
    line_of,
    lines_of_cases,
    markdown,
    methods_table,
    run_case,
    summary,
    tool_named,
)
from scripts.suites.rows import check_code, kept, run_cases

NUMBERS = [0, 1, 1000, 1001, 3000]
SAID = {0: "no_gap", 1: "payload", 1000: "payload", 1001: "backlash", 3000: "unexplained"}


def truth(
    role: str, *effects: tuple[str, str, dict[str, float]], case: str = "case-0001"
) -> dict[str, Any]:
    return {
        "format": "gap-truth/1", "case": case, "role": role, "form": "forward",
        "effects": [
            {"kind": kind, "where": where, "parameters": values, "size": {"ratio": 4.0}}
            for kind, where, values in effects
        ],
    }  # fmt: skip


def said(verdict: str, *effects: tuple[str, str, dict, dict]) -> dict[str, Any]:
    return {
        "format": "loose-gap/1", "verdict": verdict, "gap": {"before": 3.0, "after": 1.1},
        "effects": [
            {"kind": kind, "where": where, "parameters": parameters, "interval_95": interval}
            for kind, where, parameters, interval in effects
        ],
    }  # fmt: skip


@pytest.fixture
def folders(tmp_path: Path) -> Folders:
    """Recordings that hold nothing but what the stub is to say of them, and their truth."""
    made = Folders(out=tmp_path / "out", blind=tmp_path / "blind", keep=True)
    (made.blind / "truth").mkdir(parents=True)
    for number in NUMBERS:
        name, role = name_of(number), role_of(number)
        recording = made.blind / "recordings" / name
        recording.mkdir(parents=True)
        content = {"say": SAID[number], "number": number}
        (recording / "recording.json").write_text(json.dumps(content))
        shakes = ("shaking_force", "tool", {"force": 1.0})
        effects = {"none": [], "outside": [shakes]}.get(role, [("payload", "tool", {"mass": 1.0})])
        sealed = json.dumps(truth(role, *effects, case=name))
        (made.blind / "truth" / f"{name}.json").write_text(sealed)
    return made


def stub(recording: Path, folder: Path, tolerance: float = 0.03) -> None:
    """Say what stands in the recording."""
    answer = json.loads((recording / "recording.json").read_text())["say"]
    known = answer in ("no_gap", "unexplained")
    effects = [] if known else [(answer, "tool", {"mass": 1.0}, {"mass": [0.9, 1.2]})]
    result = said(answer if known else "named", *effects)
    (folder / "result.json").write_text(json.dumps(result))


def failing(recording: Path, folder: Path, tolerance: float = 0.03) -> None:
    if json.loads((recording / "recording.json").read_text())["number"] == 1000:
        raise ValueError("the step\nis too coarse")
    stub(recording, folder)


def rows_of(folders: Folders, tool: Any = stub, numbers: list[int] = NUMBERS) -> list[Any]:
    work = partial(run_case, folders=folders, tool=tool, code="c")
    return run_cases(numbers, work, folders.out / "rows.jsonl", say=line_of)


def test_cases_are_graded_and_finished_ones_are_kept(
    folders: Folders, capsys: pytest.CaptureFixture[str]
) -> None:
    rows_of(folders, numbers=NUMBERS[:2])
    assert "2/2 case-" in capsys.readouterr().out
    rows = rows_of(folders)
    assert "3/3 case-" in capsys.readouterr().out
    assert len(kept(folders.out / "rows.jsonl")) == len(NUMBERS)
    assert [row["number"] for row in rows] == NUMBERS
    assert [row["grade"]["right"] for row in rows] == [True, False, True, False, True]
    marks = grade_of(rows[2])
    assert (marks.said, marks.covered, marks.gap_after) == ((("payload", "tool"),), (True,), 1.1)
    assert "Cases that are not right" in suite.tables(rows, 5)
    with pytest.raises(InvalidSetting, match="rows of other code"):
        check_code(rows, "another", folders.out)


def test_an_exception_is_a_row_that_is_wrong(folders: Folders) -> None:
    failed = rows_of(folders, failing)[2]
    assert failed["error"] == "tool: ValueError: the step is too coarse"
    assert grade_of(failed).truth == (("payload", "tool"),) and not grade_of(failed).right
    assert "FAILED" in line_of(failed)
    trace = (folders.out / "results" / failed["case"] / "error.txt").read_text()
    assert "Traceback" in trace
    run_case(1000, folders=folders, tool=stub)
    row = run_case(1000, folders=folders, tool=lambda *_: None)  # not graded by the earlier result
    assert "result.json" in row["error"] and not row["grade"]["right"]


def test_numbers_are_chosen_by_words() -> None:
    assert numbers_of(["7", "1000-1002"]) == [7, 1000, 1001, 1002]
    with pytest.raises(InvalidSetting, match="is no case"):
        numbers_of(["all"])
    assert set(quick_list()) < set(full_list())


def test_the_table_of_methods_is_of_the_cases_that_all_have(folders: Folders) -> None:
    grades = {row["number"]: grade_of(row) for row in rows_of(folders)}
    some = {number: grades[number] for number in (1, 1000, 1001)}
    said = methods_table({"loose_gap": grades, "stepwise_bic": some, "sysid": {}})
    assert "3 cases that all methods have run: 1 1000-1001." in said
    assert said.splitlines()[2] == "| | `loose gap` | stepwise selection, BIC |"
    assert "| single effects, kind and location correct | 1/2 = 50 %" in said
    assert set(METHODS) == set(suite.TOOLS)


@pytest.mark.slow
def test_a_blind_case_is_made_given_to_the_tool_and_graded(tmp_path: Path) -> None:
    folders = Folders(out=tmp_path / "out", blind=tmp_path / "blind")
    row = run_case(1264, folders=folders, tool=tool_named("loose_gap"))
    assert row["error"] == "" and row["grade"]["right"]
    read_result(tmp_path / "out" / "results" / row["case"])
    assert not (tmp_path / "blind" / "recordings" / row["case"]).exists()
    assert (tmp_path / "blind" / "truth" / f"{row['case']}.json").exists()


# ---- marks and tables


FRICTION = ("coulomb_friction", "joint2", {"torque": 2.0})
LOAD = ("payload", "tool", {"mass": 0.5})
NAMED_FRICTION = ("coulomb_friction", "joint2", {"torque": 2.2}, {"torque": [1.9, 2.5]})
ELSEWHERE = ("coulomb_friction", "joint1", {"torque": 2.0}, {})
NAMED_PLAY = ("backlash", "joint2", {"gap": 1e-3}, {})
NAMED_LOAD = ("payload", "tool", {"mass": 0.5}, {"mass": [0.4, 0.45]})


@pytest.mark.parametrize(
    ("named", "true", "right", "found"),
    [
        ([NAMED_FRICTION], [FRICTION], True, 1),
        ([ELSEWHERE], [FRICTION], False, 0),
        ([NAMED_FRICTION, NAMED_PLAY], [FRICTION], False, 1),
        ([NAMED_LOAD, NAMED_FRICTION], [FRICTION, LOAD], True, 2),
        ([NAMED_LOAD], [FRICTION, LOAD], False, 1),
    ],
)
def test_a_list_is_right_where_kinds_and_places_are_and_none_is_too_many(
    named: list[Any], true: list[Any], right: bool, found: int
) -> None:
    marks = grade(said("named", *named), truth("single" if len(true) == 1 else "pair", *true))
    assert (marks.right, marks.found) == (right, found)


def test_parameters_and_intervals_are_judged() -> None:
    marks = grade(said("named", NAMED_LOAD, NAMED_FRICTION), truth("pair", FRICTION, LOAD))
    assert marks.parameter_error == pytest.approx((0.1, 0.0)) and marks.covered == (True, False)
    gain = truth("single", ("actuator_gain", "motor1", {"gain": 1.2}))
    marks = grade(said("named", ("actuator_gain", "motor1", {"gain": 1.1}, {})), gain)
    assert marks.parameter_error == pytest.approx((0.5,))  # by its distance from one


@pytest.mark.parametrize("separable", [True, False])
def test_a_partner_counts_only_where_the_data_cannot_tell(separable: bool) -> None:
    marks = grade(
        said("named", NAMED_PLAY), truth("single", FRICTION), separable=lambda *_: separable
    )
    assert marks.right is not separable

    def fail(*_: Any) -> bool:
        raise AssertionError("asked about a pair that is not listed")

    assert not grade(said("named", NAMED_LOAD), truth("single", FRICTION), separable=fail).right


@pytest.mark.parametrize("verdict", ["no_gap", "unexplained", "named"])
def test_nothing_missing_and_outside_have_one_right_verdict(verdict: str) -> None:
    outside = truth("outside", ("shaking_force", "tool", {"force": 1.0}))
    assert grade(said(verdict, NAMED_LOAD), truth("none")).right is (verdict == "no_gap")
    assert grade(said(verdict, NAMED_LOAD), outside).right is (verdict == "unexplained")


def test_every_kind_has_its_parameters_and_listed_pairs_are_of_the_catalogue() -> None:
    assert set(PARAMETERS) == set(CATALOGUE)
    assert all(pair <= set(CATALOGUE) and len(pair) == 2 for pair in LISTED)


def test_the_tables_count_every_case() -> None:
    grades = [
        grade(said("named", NAMED_FRICTION), truth("single", FRICTION), seconds=30.0),
        grade(said("named", NAMED_PLAY), truth("single", FRICTION)),
        grade(said("no_gap"), truth("none")),
        grade(said("unexplained"), truth("outside", ("shaking_force", "tool", {"force": 1.0}))),
    ]
    words = markdown(grades)
    for line in (
        "single effects, kind and location correct | at least 97 % | 1/2 = 50 %",
        "false alarms with nothing missing | at most 2 % | 0/1",
        "outside the catalogue, called unexplained | at least 90 % | 1/1",
        "held-out RMS residual after, representable effects, median [noise sd] | at most 1.25 "
        "| 1.10",
        "2 to 5 | 1/2",
    ):
        assert f"\n| {line}" in words
    assert "no cases" in markdown([])
    _, _, first, second = lines_of_cases(
        [(1003, grades[1], ""), (7, grades[2], "no | runs")]
    ).splitlines()
    assert first.startswith(
        "| 1003 | forward | coulomb_friction at joint2 | 4.0 | backlash at joint2"
    )
    assert "| nothing | " in second and "failed: no \\| runs |" in second


def test_further_parameters_are_graded_apart_where_they_mean_the_same():
    ripple = ("torque_ripple", "joint1", {"amplitude": 1.0, "order": 12.0, "phase": -3.0})
    periods, phase = {"periods": [11.9, 12.1]}, {"phase": [3.2, 3.4]}  # a turn further on
    named = (
        "torque_ripple",
        "joint1",
        {"amplitude": 1.0},
        {"amplitude": [0.9, 1.1], **periods, **phase},
    )
    marks = grade(said("named", named), truth("single", ripple))
    assert marks.covered == (True,) and marks.covered_others == (True, True)
    bump = {"torque": 1.0, "static_torque": 1.8, "speed": 0.1}
    friction = ("stribeck_friction", "joint1", bump)
    named = (
        "stribeck_friction", "joint1", {"torque": 1.0},
        {"torque": [0.9, 1.1], "static_ratio": [1.2, 1.5], "speed": [0.05, 0.2]},
    )  # fmt: skip
    marks = grade(said("named", named), truth("single", friction))
    assert marks.covered_others == (False, True)
    lines = [line for line in summary([marks]) if "further parameters" in line[0]]
    assert lines[0][2].startswith("1/2")


# ---- other methods

XML = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.00025" integrator="RK4"/>
  <worldbody>
    <body name="link1">
      <inertial mass="3" pos=".2 0 0" diaginertia=".01 .06 .06"/>
      <joint name="joint1" axis="0 1 0" damping="1" armature=".2"/>
      <body name="link2" pos=".4 0 0">
        <inertial mass="1.5" pos=".15 0 0" diaginertia=".005 .02 .02"/>
        <joint name="joint2" axis="0 1 0" damping=".5" armature=".08"/>
        <site name="tool" pos=".3 0 0"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="motor1" joint="joint1" kp="1500" kv="60"/>
    <position name="motor2" joint="joint2" kp="600" kv="20"/>
  </actuator>
  <sensor>
    <jointpos name="joint1_pos" joint="joint1"/><jointvel name="joint1_vel" joint="joint1"/>
    <jointpos name="joint2_pos" joint="joint2"/><jointvel name="joint2_vel" joint="joint2"/>
  </sensor>
</mujoco>
"""
TORQUE = 1.5
"""Dry friction that is planted [N m]."""


def write_arm(folder: Path, *, friction: float, seconds: float = 3.0, runs: int = 3) -> Path:
    """A recording of an arm with dry friction at its first joint, its model without."""
    rng = np.random.default_rng(7)
    model = mujoco.MjModel.from_xml_string(XML)
    time = np.arange(round(seconds * 1000)) / 1000
    recorded = []
    for i in range(runs):
        commands = sum(
            np.sin(2 * np.pi * f * time[:, None] + rng.uniform(0, 6, 2)) * 0.25 / f
            for f in (0.4, 0.9, 1.7, 2.9)
        )
        commands *= np.minimum(1.0, time / 0.5)[:, None]
        data = mujoco.MjData(model)
        read = np.empty((len(time), 4))
        for k, command in enumerate(commands):
            read[k, :2], read[k, 2:] = data.qpos, data.qvel
            data.ctrl = command
            for _ in range(4):  # steps in a sample
                # MuJoCo's own dry friction is soft: it would be another law
                data.qfrc_applied[0] = -friction * np.tanh(data.qvel[0] / 3e-3)
                mujoco.mj_step(model, data)
        read += rng.normal(size=read.shape) * [1e-4, 1e-4, 2e-3, 2e-3]
        names = ("joint1_pos", "joint2_pos", "joint1_vel", "joint2_vel")
        sensors = {name: read[:, c] for c, name in enumerate(names)}
        controls = {"motor1": commands[:, 0], "motor2": commands[:, 1]}
        recorded.append(Run(name=f"run-{i}", time=time, controls=controls, sensors=sensors))
    write_recording(folder, model_xml=XML, runs=recorded)
    return folder


def marks_of(recording: Path, folder: Path, name: str, *, torque: float | None) -> Grade:
    """Marks of a method against the planted friction, or against nothing."""
    tool_named(name)(recording, folder, 0.03)
    planted = truth("none")
    if torque is not None:
        planted = truth("single", ("coulomb_friction", "joint1", {"torque": torque}))
    return grade(json.loads((folder / "result.json").read_text("utf-8")), planted)


@pytest.mark.slow
def test_stepwise_selection_names_planted_friction_and_nothing_else(tmp_path: Path) -> None:
    rubbing = write_arm(tmp_path / "rubbing", friction=TORQUE)
    marks = marks_of(rubbing, tmp_path, "stepwise_bic", torque=TORQUE)
    assert marks.right and marks.parameter_error[0] < 0.15
    assert marks.gap_after < 1.25 < marks.gap_before
    sound = write_arm(tmp_path / "sound", friction=0.0)
    assert marks_of(sound, tmp_path, "stepwise_bic", torque=None).right


@pytest.mark.slow
def test_sysid_predicts_the_held_out_run(tmp_path: Path) -> None:
    sysid = pytest.importorskip("mujoco.sysid")
    if not hasattr(sysid, "Parameter"):
        pytest.skip("mujoco.sysid lacks its own optional packages: pip install 'mujoco[sysid]'")
    arm = write_arm(tmp_path / "arm", friction=TORQUE, seconds=2.0, runs=2)
    marks = marks_of(arm, tmp_path, "sysid", torque=TORQUE)
    assert marks.gap_after < marks.gap_before
