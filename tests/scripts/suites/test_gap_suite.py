"""The suite runs, resumes, keeps the truth sealed, and turns what goes wrong into rows."""

from __future__ import annotations

import json
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("numba")
pytest.importorskip("joblib")

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.gap import Tolerances
from scripts.suites.gap import ablation
from scripts.suites.gap import run as suite
from scripts.suites.gap.cases import name_of, role_of
from scripts.suites.gap.grading import failed, grade, methods_table, table
from scripts.suites.gap.run import RunSettings, run, tool_of
from scripts.suites.rows import kept

STUB = "tests.scripts.suites.test_gap_suite:stub"
NUMBERS = [0, 1, 12, 36]  # one, one, none, outside


def stub(recording: Path) -> dict[str, Any]:
    """Say what stands in the recording."""
    said = json.loads((recording / "recording.json").read_text())
    if said == "fail":
        raise ValueError("the step is too coarse")
    return dict(said)


def truth(role: str, *effects: tuple[str, str, dict[str, float]], **rest: Any) -> dict[str, Any]:
    """Truth of a case of three joints; an effect from outside is accepted under no name."""
    return {
        "format": "gap-truth/2", "case": "case-1", "role": role, "world": "servo",
        "machine": "planar3", "joints": 3, "ignored": [], "neutral": [],
        "effects": [
            {"kind": kind, "where": where, "index": 1, "accept": [[[kind, where]]],
             "values": {name: {"value": value, "unit": ""} for name, value in values.items()}}
            for kind, where, values in effects
        ],
    } | rest  # fmt: skip


def said(verdict: str, *effects: tuple[str, str, dict, dict]) -> dict[str, Any]:
    return {
        "verdict": verdict,
        "effects": [
            {"kind": kind, "where": where, "parameters": parameters, "interval_95": interval}
            for kind, where, parameters, interval in effects
        ],
    }


FRICTION = ("coulomb_friction", "joint2", {"torque": 2.0})
LOAD = ("payload", "tool", {"mass": 0.5})
NAMED_FRICTION = ("coulomb_friction", "joint2", {"torque": 2.2}, {"torque": [1.9, 2.5]})
ELSEWHERE = ("coulomb_friction", "joint1", {"torque": 2.0}, {})
EVERYWHERE = ("coulomb_friction", "all", {"torque": 2.0}, {})
NAMED_PLAY = ("backlash", "joint2", {"gap": 1e-3}, {})
NAMED_LOAD = ("payload", "tool", {"mass": 0.5}, {"mass": [0.4, 0.45]})


@pytest.mark.parametrize(
    ("named", "true", "right", "found"),
    [
        ([NAMED_FRICTION], [FRICTION], True, 1),
        ([ELSEWHERE], [FRICTION], False, 0),
        ([EVERYWHERE], [FRICTION], False, 1),
        ([NAMED_FRICTION, NAMED_PLAY], [FRICTION], False, 1),
        ([NAMED_LOAD, NAMED_FRICTION], [FRICTION, LOAD], True, 2),
        ([NAMED_LOAD], [FRICTION, LOAD], False, 1),
    ],
)
def test_a_list_is_right_where_kinds_and_places_are_and_none_is_too_many(
    named: list[Any], true: list[Any], right: bool, found: int
) -> None:
    marks = grade(said("named", *named), truth("one" if len(true) == 1 else "two", *true))
    assert (marks["right"], sum(marks["found"])) == (right, found)


def test_equal_names_count_as_right_and_spoiled_places_not_at_all() -> None:
    true = truth("one", ("command_delay", "all", {"delay": 0.01}), ignored=["joint2"])
    each = [("command_delay", f"motor{k}", {"delay": 0.01}, {}) for k in (1, 2, 3)]
    true["effects"][0]["accept"].append([[kind, where] for kind, where, _, _ in each])
    assert grade(said("named", *each, NAMED_PLAY), true)["right"]
    part = grade(said("named", *each[:2]), true)
    assert part["false"] == [] and not part["right"]
    straight = truth("none", neutral=[["command_interpolation", "*"]])
    assert grade(said("named", ("command_interpolation", "all", {}, {})), straight)["right"]


def test_parameters_and_intervals_are_judged() -> None:
    marks = grade(said("named", NAMED_LOAD, NAMED_FRICTION), truth("two", FRICTION, LOAD))
    assert marks["errors"] == pytest.approx([0.1, 0.0]) and marks["held"] == [True, False]
    gain = truth("one", ("actuator_gain", "motor1", {"gain": 1.2}))
    marks = grade(said("named", ("actuator_gain", "motor1", {"gain": 1.1}, {})), gain)
    assert marks["errors"] == pytest.approx([0.5])  # by its distance from one


@pytest.mark.parametrize("verdict", ["no_gap", "unexplained", "named"])
def test_nothing_missing_and_outside_have_one_right_verdict(verdict: str) -> None:
    named = [NAMED_LOAD] if verdict == "named" else []
    outside = truth("outside", ("shaking_force", "tool", {}))
    assert grade(said(verdict, *named), truth("none"))["right"] is (verdict == "no_gap")
    assert grade(said(verdict, *named), outside)["right"] is (verdict == "unexplained")


@pytest.fixture
def blind(tmp_path: Path) -> Path:
    """Recordings that hold nothing but what the stub is to say of them, and their truth."""
    answers = {
        0: said("named", NAMED_FRICTION), 1: "fail", 12: said("named", NAMED_LOAD),
        36: said("unexplained"),
    }  # fmt: skip
    (tmp_path / "truth").mkdir()
    for number in NUMBERS:
        name, role = name_of(number), role_of(number)
        (tmp_path / "recordings" / name).mkdir(parents=True)
        file = tmp_path / "recordings" / name / "recording.json"
        file.write_text(json.dumps(answers[number]))
        effects = {"none": [], "outside": [("shaking_force", "tool", {})]}.get(role, [FRICTION])
        sealed = json.dumps(truth(role, *effects, case=name))
        (tmp_path / "truth" / f"{name}.json").write_text(sealed)
    return tmp_path


@pytest.mark.slow
def test_cases_are_graded_kept_and_go_on(blind: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def settings(*numbers: int, **rest: Any) -> RunSettings:
        words = tuple(map(str, numbers))
        return RunSettings(numbers=words, tool=STUB, out=blind / "out", blind=blind, **rest)

    run(settings(*NUMBERS[:2]))
    run(settings(*NUMBERS))
    printed = capsys.readouterr().out
    assert "FAILED gap suite: the step is too coarse" in printed and "1/2 " in printed
    rows = kept(blind / "out" / "rows.jsonl")
    assert [row["right"] for row in rows] == [True, False, False, True]
    assert all(row["memory"] > 10 for row in rows if not row["error"])
    assert "| nothing missing, nothing named | 98 % | 0/1" in table(rows)
    assert "4 cases that all tools have run" in methods_table({"a": rows, "b": rows})
    with pytest.raises(InvalidSetting, match="of another phrase"):
        (blind / "out" / "rows.jsonl").write_text(json.dumps(rows[0] | {"phrase": "x"}))
        run(settings(0))
    with pytest.raises(InvalidSetting, match="no tool 'other'"):
        tool_of("other")
    for name, value in (("most_seconds", -1.0), ("most_seconds", float("nan")), ("workers", 0)):
        with pytest.raises(InvalidSetting, match=f"RunSettings.{name} must be"):
            RunSettings(**{name: value})
    assert not failed(truth("none"))["right"]


@pytest.mark.slow
def test_files_enter_against_commitments_made_from_a_phrase(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    suite, answers = tmp_path / "suite", tmp_path / "answers"
    answers.mkdir()
    given = RunSettings(numbers=("10020-10021",), phrase="of the tests", make=suite)
    run(given)
    told = (suite / "protocol.json").read_text()
    commitments = (suite / "commitments.json").read_text()
    run(given)
    assert (suite / "commitments.json").read_text() == commitments
    names = json.loads(told)["cases"]
    assert "coulomb_friction" in json.loads(told)["kinds"] and "truth" not in told
    for name in names:
        sealed = json.loads((suite / "truth" / f"{name}.json").read_text())
        effects = [
            (e["kind"], e["where"], {k: v["value"] for k, v in e["values"].items()}, {})
            for e in sealed["effects"]
        ]
        (answers / f"{name}.json").write_text(json.dumps(said("named", *effects)))
    entered = replace(given, make=None, blind=suite, answers=answers, out=tmp_path / "out")
    run(entered)
    assert "found |  | 2/2 = 100 %" in capsys.readouterr().out
    (answers / f"{names[0]}.json").write_text('{"verdict": "maybe"}')
    with pytest.raises(InvalidData, match="a verdict is one of"):
        run(replace(entered, afresh=True))
    sealed_file = suite / "truth" / f"{names[0]}.json"
    sealed_file.write_text(sealed_file.read_text() + " ")
    (answers / f"{names[0]}.json").write_text('{"verdict": "no_gap"}')
    with pytest.raises(InvalidData, match="is not the truth"):
        run(replace(entered, afresh=True))


@pytest.mark.parametrize("name", ["without discrepancy", "core.selection.KIND=20"])
def test_a_variant_changes_a_number_wherever_it_is_known(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    changes = ablation.variants()[name]
    assert len(changes) > 1
    for key in changes:  # restored after the test
        module, _, constant = f"loose_env.gap.{key}".rpartition(".")
        monkeypatch.setattr(f"{module}.{constant}", getattr(import_module(module), constant))
    assert ablation.changed(name) == {"tolerances": Tolerances()}
    for key, value in changes.items():
        module, _, constant = f"loose_env.gap.{key}".rpartition(".")
        assert getattr(import_module(module), constant) == value


def test_every_number_that_decides_exists_and_is_changed_both_ways() -> None:
    known = ablation.variants()
    assert len(known) == 7 + 2 * len(ablation.NUMBERS)
    assert all(known.values())
    assert ablation.changed("without exact fit") == {
        "tolerances": Tolerances(), "simulate": False
    }  # fmt: skip
    none = ablation.changed("without rigid nuisances")["tolerances"]
    assert none.mass < 1e-4 and none.damping == Tolerances().damping
    with pytest.raises(InvalidSetting, match="no variant 'without care'"):
        tool_of("loose_gap@without care")(Path())


def test_an_ablation_runs_the_cheap_cases_and_tells_names_that_change(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    true = [truth("one", FRICTION), truth("none")]
    right = [grade(said("named", NAMED_FRICTION), true[0]), grade(said("no_gap"), true[1])]
    wrong = [grade(said("unexplained"), true[0]), grade(said("named", NAMED_PLAY), true[1])]
    asked: list[tuple[str, int]] = []

    def work(number: int, *, tool: str, **_: Any) -> dict[str, Any]:
        asked.append((tool, number))
        if number == 2:
            return right[1] | {"code": "a", "error": "", "cpu": 9.0, "number": 2, "phrase": ""}
        marks = (right if tool == "loose_gap" else wrong)[number]
        return marks | {"code": "a", "error": "", "cpu": 2.0, "number": number, "phrase": ""}

    monkeypatch.setattr(suite, "run_case", work)
    monkeypatch.setattr(suite, "code_of", lambda tool: "a")

    def ablated(words: str, *numbers: str) -> str:
        run(RunSettings(numbers=numbers, out=tmp_path, ablate=(words,), most_seconds=5.0))
        return capsys.readouterr().out

    ablated("without exact", "0")
    printed = ablated("without exact", "0", "1", "2")
    named = ["loose_gap", "loose_gap@without exact fit"]
    assert asked == [(named[0], 0), (named[1], 0), (named[0], 1), (named[0], 2), (named[1], 1)]
    assert "2 of 3 cases, those that took 5 s" in printed
    assert "| as shipped | 1/1 | none | 1/1 | none | 0 | 0/2 | 2 s |" in printed
    assert "| without exact fit | 0/1 | none | 0/1 | none | 1 | 2/2 | 2 s |" in printed
    assert "0: -coulomb_friction@joint2; 1: +backlash@joint2" in printed
    with pytest.raises(InvalidSetting, match="no variant begins with"):
        ablated("with care", "0")
    monkeypatch.setattr(suite, "code_of", lambda tool: "b")
    with pytest.raises(InvalidSetting, match="rows of other code"):
        ablated("without exact", "0")
