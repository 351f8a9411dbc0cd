"""Reports of diagnosis, plan and trend: no surer than the result, the same in every form."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

pytest.importorskip("jinja2")
pytest.importorskip("matplotlib")

from loose_env import report
from loose_env.arms import DESK_ARM
from loose_env.errors import MissingExtra
from loose_env.instrument import (
    Diagnosis,
    Numbers,
    Place,
    PlaceVerdict,
    PlanSettings,
    RunSeen,
    Trend,
    Visit,
    read_diagnosis,
)
from loose_env.instrument import plan as planned
from tests.report.page_checks import checked, words

BOLTS, GEARS = "structural_looseness", "backlash"
VERDICTS: dict[str, PlaceVerdict]
VERDICTS = {"l": "loose", "s": "suspect", "t": "tight", "n": "not tested"}
PLACES = [(BOLTS, "upper_arm"), (GEARS, "elbow"), (BOLTS, "hand"), (GEARS, "turn")]


def run(k: int, *, told: bool, healthy: bool = False) -> RunSeen:
    heard = tuple((np.arange(100) % (7 + k)).astype(float).tolist())
    lines = tuple((1 + np.arange(29) % 2 * 0.5).tolist())
    return RunSeen(
        file=f"run-{k:02d}.csv", condition="suspect", used=True, repeats=0.9,
        pose={"base": 0.3, "shoulder": -0.25 * k, "elbow": 1.0},
        heard=heard, foretold=heard if told else (),
        lines_hz=tuple(np.arange(1.0, 30.0).tolist()),
        lines=lines, healthy_lines=lines if healthy else (),
    )  # fmt: skip


def found(verdicts: str, **more: object) -> Diagnosis:
    """Diagnosis whose places have verdicts by letter: loose, suspect, tight, not tested."""
    places = tuple(
        Place(
            kind=kind,
            at=at,
            verdict=VERDICTS[letter],
            probability={"l": 0.97, "s": 0.4}.get(letter, 0.0),
            rhythm=0.6 if letter in "ls" else 0.1,
            tested=0.3 if letter == "n" else 1.0,
            direction=(0.0, 0.6, 0.8) if kind == BOLTS else None,
            why="its load reversed, and it was not heard" if letter == "t" else "",
        )
        for letter, (kind, at) in zip(verdicts, PLACES, strict=True)
    )
    told = verdicts[0] in "ls"
    given: dict[str, object] = {
        "verdict": "loose" if told else "tight",
        "headline": "The seat of link upper_arm is loose.",
        "remedy": "Torque the bolts of link upper_arm, then repeat the session.",
        "settled": verdicts[0] == "l",
        "places": places,
        "reasons": ("the top band rings in the rhythm of a knock: correlation 0.60",),
        "remarks": ("run-01.csv: what rings does not repeat",),
        "evidence": {"knocks": 12.0, "rhythm": 0.6, "gears_left": 0.02},
        "runs": tuple(run(k, told=told) for k in (1, 2, 3)),
        "date": "2026-03-18T14:05:00+00:00",
        "version": "0.1.0",
        "settings": {"healthy": Numbers.healthy, "sure": Numbers.sure},
        **more,
    }
    return Diagnosis(**given)  # type: ignore[arg-type]


UNUSED = (replace(run(1, told=False), used=False, why="a column lacks"),)
CASES = {
    "settled": found("lttn"),
    "with reference": found("lttn", reference=True, runs=(run(1, told=True, healthy=True),)),
    "open": found("sstt", headline="Something knocks: the seat of link upper_arm or ..."),
    "untested": found("tttn", headline="Nothing knocks: 3 of 4 places are tight, 1 was not."),
    "tight": found("tttt", headline="Nothing knocks: 4 of 4 places are tight."),
    "refused": found("nnnn", verdict="refused", headline="Nothing.", evidence={}, runs=UNUSED),
    "hobby": found("sttt", hobby=True, headline="Something knocks, as in every arm of this class."),
}
"""Each kind of result."""


@pytest.mark.parametrize("case", CASES)
def test_page_terminal_and_notebook_say_the_same(case: str, tmp_path: Path) -> None:
    d = CASES[case]
    written = report.write_diagnosis(tmp_path, d, DESK_ARM, recording="cell <4>")
    assert [path.name for path in written] == ["report.html", "result.json"]
    assert read_diagnosis(tmp_path) == d
    page = written[0].read_text("utf-8")
    checked(page)
    assert "cell &lt;4&gt;" in page and page.count("<svg") == (0 if case == "refused" else 3)
    said, text = words(page), report.diagnosis_text(d, folder="runs/cell 4")
    assert text.splitlines()[0] == report.diagnosis_headline(d)
    ElementTree.fromstring(f"<div>{report.diagnosis_html(d)}</div>")  # every element is closed
    for shown in (said, text, report.diagnosis_html(d)):
        assert report.diagnosis_headline(d) in shown and d.remedy in shown
        assert ("LOOSE" in shown) == d.settled
        assert ("not tested" in shown.replace("is not tested may", "")) == bool(d.untested)
        assert "run-01.csv: what rings" in shown
        assert all(place.at in shown for place in d.places)
    assert ("97 %" in text) == d.settled and d.version in said and d.date in said
    assert all(each.file in said and each.why in said for each in d.runs)


def test_commands_carry_out_the_next_step() -> None:
    def commands(case: str) -> list[str]:
        lines = report.diagnosis_text(CASES[case], folder="s 1/recording").splitlines()
        return [line.strip() for line in lines if line.startswith("  loose ")]

    known = "--out 's 1' --known 's 1/diagnosis'"
    assert commands("open")[0] == f"loose plan 's 1/recording/model.xml' {known}"
    assert commands("untested") == commands("open")
    assert commands("tight") == []
    assert commands("settled")[1].startswith("loose diagnose session-after/recording")
    assert commands("hobby")[0].startswith("loose trend ")
    assert commands("refused")[0] == "loose doctor 's 1/recording'"


def test_without_what_draws_the_result_is_written_and_the_reason_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing(*_: object, **__: object) -> str:
        raise MissingExtra("figures need matplotlib")

    monkeypatch.setattr("loose_env.report.diagnosis.render_page", missing)
    (tmp_path / "report.html").write_text("old")
    heard: list[str] = []
    d = CASES["settled"]
    done = report.write_diagnosis(tmp_path, d, DESK_ARM, recording="cell", say=heard.append)
    assert [path.name for path in done] == ["result.json"] == [p.name for p in tmp_path.iterdir()]
    assert heard == ["no report.html: figures need matplotlib"]
    monkeypatch.undo()
    other = replace(d, places=(replace(d.places[0], at="leg"),))
    page = report.write_diagnosis(tmp_path, other, DESK_ARM, recording="cell")[0].read_text("utf-8")
    assert "The arm is not drawn" in words(page) and page.count("<svg") == 2


def test_a_plan_is_a_sheet_for_the_machine(tmp_path: Path) -> None:
    made, _ = planned(DESK_ARM, PlanSettings(poses=3, controller="hobby_servo", reference=True))
    page = report.write_plan_page(tmp_path / "plan.html", made, folder="my s", model="arm.xml")
    said, text = words(page.read_text("utf-8")), report.summary(made)
    checked(page.read_text("utf-8"))
    assert all(command in said for command in report.plan_commands("my s", "arm.xml"))
    for part in ("emergency stop", "tenth", "reference-01.csv", "make_robot_from_config", "'my s"):
        assert part in said
    for shown in (said, text):
        assert "3 poses, 17 s" in shown and "run-03.csv" in shown and "°" in shown
        assert all(place.split("@")[1] in shown for place in made.tested)


def test_a_trend_names_what_left_its_band(tmp_path: Path) -> None:
    visits = [Visit(name="may", date="", values={}, alarm=False, diagnosis=None)]
    for name, top in (("june", 0.2), ("july", 9.0)):
        values = {"knocks": 0.4, "top_db": top}
        case = CASES["settled" if top > 3 else "tight"]
        visits.append(Visit(name=name, date="", values=values, alarm=top > 3, diagnosis=case))
    bands = {"knocks": 4.0, "top_db": 3.0, "even_db": 1.5, "odd_db": 2.0}
    t = Trend(headline="Changed since july", visits=tuple(visits), bands=bands, since="july")
    page = report.write_trend_page(tmp_path / "trend.html", t).read_text("utf-8")
    checked(page)
    for shown in (words(page), report.trend_text(t)):
        assert "Changed since july." in shown and "9.00" in shown and "LOOSE" in shown
    calm = replace(t, headline="No change in 2 sessions.", visits=tuple(visits[:2]), since=None)
    assert "play the same plan next month" in report.trend_text(calm).lower()
