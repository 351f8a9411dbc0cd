"""Marks: what counts as right, what counts as a false alarm, what the tables show."""

from __future__ import annotations

import pytest

pytest.importorskip("numba")

from scripts.suites.gap.effects import CATALOGUE
from scripts.suites.gap.grading import LISTED, PARAMETERS, grade
from scripts.suites.gap.tables import confusion, lines_of_cases, markdown, summary, text


def truth(role: str, *effects: tuple[str, str, dict]) -> dict:
    return {
        "format": "gap-truth/1",
        "case": "case-0001",
        "role": role,
        "form": "forward",
        "effects": [
            {"kind": kind, "where": where, "parameters": parameters, "size": {"ratio": 4.0}}
            for kind, where, parameters in effects
        ],
    }


def said(verdict: str, *effects: tuple[str, str, dict, dict]) -> dict:
    return {
        "format": "loose-gap/1",
        "verdict": verdict,
        "effects": [
            {"kind": kind, "where": where, "parameters": parameters, "interval_95": interval}
            for kind, where, parameters, interval in effects
        ],
        "gap": {"before": 3.0, "after": 1.1},
    }


FRICTION = ("coulomb_friction", "joint2", {"torque": 2.0})
NAMED_FRICTION = ("coulomb_friction", "joint2", {"torque": 2.2}, {"torque": [1.9, 2.5]})
NAMED_PLAY = ("backlash", "joint2", {"gap": 1e-3}, {})
NAMED_LOAD = ("payload", "tool", {"mass": 0.5}, {"mass": [0.4, 0.45]})


def test_the_right_kind_at_the_right_place_is_right():
    marks = grade(said("named", NAMED_FRICTION), truth("single", FRICTION))
    assert marks.right
    assert marks.parameter_error == pytest.approx((0.1,))
    assert marks.covered == (True,)


def test_the_right_kind_at_another_place_is_wrong():
    elsewhere = ("coulomb_friction", "joint1", {"torque": 2.0}, {})
    assert not grade(said("named", elsewhere), truth("single", FRICTION)).right


def test_listing_more_than_one_is_wrong():
    marks = grade(said("named", NAMED_FRICTION, NAMED_PLAY), truth("single", FRICTION))
    assert not marks.right
    assert marks.found == 1


@pytest.mark.parametrize("separable", [True, False])
def test_a_partner_counts_only_where_the_data_cannot_tell(separable):
    marks = grade(
        said("named", NAMED_PLAY),
        truth("single", FRICTION),
        separable=lambda effect, named: separable,
    )
    assert marks.right is not separable
    assert marks.by_alternative is not separable


def test_nobody_asks_about_pairs_that_are_not_listed():
    def fail(effect: int, named: tuple[str, str]) -> bool:
        raise AssertionError("asked")

    assert not grade(said("named", NAMED_LOAD), truth("single", FRICTION), separable=fail).right


def test_of_a_pair_both_count():
    load = ("payload", "tool", {"mass": 0.5})
    both = truth("pair", FRICTION, load)
    marks = grade(said("named", NAMED_LOAD, NAMED_FRICTION), both)
    assert marks.right
    assert marks.covered == (True, False)
    half = grade(said("named", NAMED_LOAD), both)
    assert not half.right
    assert half.found == 1


@pytest.mark.parametrize("verdict", ["no_gap", "unexplained", "named"])
def test_nothing_missing_and_outside_have_one_right_verdict(verdict):
    result = said(verdict, NAMED_LOAD)
    outside = truth("outside", ("shaking_force", "tool", {"force": 1.0}))
    assert grade(result, truth("none")).right is (verdict == "no_gap")
    assert grade(result, outside).right is (verdict == "unexplained")


def test_a_gain_is_judged_by_its_distance_from_one():
    true = truth("single", ("actuator_gain", "motor1", {"gain": 1.2}))
    marks = grade(said("named", ("actuator_gain", "motor1", {"gain": 1.1}, {})), true)
    assert marks.parameter_error == pytest.approx((0.5,))


def test_a_foreign_format_is_refused():
    with pytest.raises(ValueError, match="loose-gap/1"):
        grade({"format": "other"}, truth("none"))


def test_every_kind_has_its_parameters_and_listed_pairs_are_of_the_catalogue():
    assert set(PARAMETERS) == set(CATALOGUE)
    assert all(pair <= set(CATALOGUE) and len(pair) == 2 for pair in LISTED)


def test_the_tables_count_every_case():
    grades = [
        grade(said("named", NAMED_FRICTION), truth("single", FRICTION), seconds=30.0),
        grade(said("named", NAMED_PLAY), truth("single", FRICTION)),
        grade(said("named", NAMED_FRICTION, NAMED_PLAY), truth("single", FRICTION)),
        grade(
            said("named", ("coulomb_friction", "joint1", {"torque": 1.0}, {})),
            truth("single", FRICTION),
        ),
        grade(said("no_gap"), truth("none")),
        grade(said("unexplained"), truth("outside", ("shaking_force", "tool", {"force": 1.0}))),
    ]
    rows, columns, counts = confusion(grades)
    row = rows.index("coulomb_friction")
    for column in ("coulomb_friction", "backlash", "several", "elsewhere"):
        assert counts[row, columns.index(column)] == 1
    assert counts.sum() == len(grades)
    measured = {what: got for what, _, got in summary(grades)}
    assert measured["single effects, kind and location correct"].startswith("1/4 = 25 %")
    assert measured["false alarms with nothing missing"].startswith("0/1")
    assert (
        measured["held-out RMS residual after, representable effects, median [noise sd]"] == "1.10"
    )
    assert "? unexplained" in markdown(grades) and "! failed" not in markdown(grades)
    assert "| ?\N{NO-BREAK SPACE}shaking_force |" in markdown(grades)
    number = CATALOGUE.index("coulomb_friction") + 1
    (line,) = [row for row in markdown(grades).splitlines() if "coulomb_friction" in row]
    assert line.startswith(f"| {number}\N{NO-BREAK SPACE}coulomb_friction |") and "**1**" in line
    assert "coulomb_friction" in text(grades)
    assert "no\N{NO-BREAK SPACE}cases" in markdown([])


def test_the_table_of_cases_that_are_not_right():
    friction = ("coulomb_friction", "joint2", {"torque": 1.0})
    taken = grade(said("named", NAMED_PLAY), truth("single", friction))
    lost = grade(said("unexplained"), truth("none"))
    _, _, first, second = lines_of_cases([(1003, taken, ""), (7, lost, "no | runs")]).splitlines()
    assert [cell.strip() for cell in first.split("|")][1:4] == [
        "1003",
        "forward",
        "coulomb_friction at joint2",
    ]
    assert "backlash at " in first and second.startswith("| 7 | ")
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
