"""The suite runs, resumes, keeps the truth sealed, and turns what goes wrong into rows."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("numba")
pytest.importorskip("joblib")

from loose_env.errors import InvalidSetting
from loose_env.gap import read_result
from scripts.suites.gap import run as suite
from scripts.suites.gap.cases import name_of, role_of
from scripts.suites.gap.grading import grade
from scripts.suites.gap.run import (
    Folders,
    grade_of,
    line_of,
    run_case,
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


# ---- other methods


# ---- other methods


@pytest.mark.slow
@pytest.mark.parametrize("name", ["stepwise_bic", "sysid"])
def test_another_method_predicts_the_held_out_run_of_a_blind_case(
    name: str, tmp_path: Path
) -> None:
    if name == "sysid":
        sysid = pytest.importorskip("mujoco.sysid")
        if not hasattr(sysid, "Parameter"):
            pytest.skip("mujoco.sysid lacks its optional packages: pip install 'mujoco[sysid]'")
    folders = Folders(out=tmp_path / "out", blind=tmp_path / "blind")
    row = run_case(1264, folders=folders, tool=tool_named(name))
    marks = grade_of(row)
    assert row["error"] == "" and marks.gap_after < marks.gap_before
