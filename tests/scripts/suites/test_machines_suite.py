from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from loose_env.recording import read_recording
from scripts.suites.machines.__main__ import (
    line_of,
    main,
    result_of,
    row_of,
    tables,
    truth_of,
    write,
)
from scripts.suites.machines.case import CaseSettings, draw, play
from scripts.suites.machines.machine import Unstable
from scripts.suites.rows import kept
from tests.instrument.test_result import diagnosis

SHORT = CaseSettings(runs=2, poses=1, seconds=0.3)


def row(**changed: Any) -> dict[str, Any]:
    base: dict[str, Any] = {
        "case": 1, "seed": 1, "joints": 4, "servoed": True, "rate": 1000.0, "reference": False,
        "disturbances": {"cables": {}}, "truth": "structural_looseness@link2", "link": 2,
        "gap": 1e-4, "opens": True, "named": "structural_looseness@link2", "named_link": 2,
        "probability": 0.99, "verdict": "faulty", "angle": 3.0, "gap_named": 2e-4, "used": 3,
        "seconds": 5.0, "only": None,
    }  # fmt: skip
    return base | changed


HEALTHY = {"truth": "healthy", "link": None, "gap": None, "opens": False}


def test_a_recording_reads_and_tells_nothing_of_the_truth(tmp_path: Path) -> None:
    made = play(draw(7, 1, SHORT))
    write(made, tmp_path / made.case.name)
    read = read_recording(tmp_path / made.case.name)
    assert [run.condition for run in read.runs] == ["healthy"] * 2 + ["suspect"] * 2
    assert read.runs[0].samples == round(0.3 * made.case.rate)
    words = "".join(p.read_text("utf-8") for p in (tmp_path / made.case.name).glob("*.[jx]*"))
    assert not any(word in words for word in ("seat", "gear", "looseness", "backlash"))
    truth = truth_of(made)
    assert truth["truth"] == made.case.truth and len(truth["change"]) == 2
    assert json.loads(json.dumps(truth))["link"] == truth["link"]


def test_a_result_is_kept_with_its_verdict_and_errors() -> None:
    found = result_of(diagnosis(), play(draw(7, 1, SHORT)))
    assert found["verdict"] in ("healthy", "faulty", "open", "model_mismatch")
    assert found["named"] == diagnosis().fault.hypothesis
    json.dumps(found)


@pytest.mark.slow
def test_a_case_is_diagnosed_and_a_finished_one_is_kept(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "rows.jsonl"
    words = [
        "--cases", "1", "--first", "8", "--seed", "1", "--runs", "2", "--poses", "1",
        "--seconds", "0.5", "--only", "none", "--out", str(file),
    ]  # fmt: skip
    main(words)
    first = capsys.readouterr().out
    assert "1/1 8" in first and "| sure false alarms, without reference |" in first
    with file.open("a", encoding="utf-8") as rows:
        rows.write('{"case": 9, "se')  # cut off
    main(words)
    assert "1/1" not in capsys.readouterr().out
    assert len(kept(file)) == 1 and kept(file)[0]["disturbances"] == {}


def test_a_machine_that_holds_no_pose_is_counted_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    def falls(*_: Any) -> None:
        raise Unstable("a joint left its pose by more than 0.1 rad")

    monkeypatch.setattr("scripts.suites.machines.__main__.play", falls)
    found = row_of(3, 1, SHORT)
    assert "left its pose" in line_of(found)
    assert tables([found, row(**HEALTHY)]).startswith("1 cases, seed 1. 1 more machines")


def test_tables_count_false_alarms_links_and_what_was_refused() -> None:
    refused = row(error="no run can be used", **HEALTHY)
    for name in ("named", "named_link", "probability", "verdict", "angle", "gap_named", "used"):
        del refused[name]
    rows = [
        row(),
        row(named="backlash@joint2"),
        row(named="structural_looseness@link3", named_link=3),
        row(named="structural_looseness@link3", named_link=3, verdict="model_mismatch"),
        row(opens=False, verdict="healthy", named="healthy", named_link=None),
        row(**HEALTHY),
        row(**HEALTHY, reference=True, verdict="healthy", named="healthy", named_link=None),
        refused,
    ]
    said = tables(rows)
    assert "| sure false alarms, without reference | at most 2 % | 1 of 2 = 50.0%" in said
    assert "| sure false alarms, with reference | at most 0.5 % | 0 of 1 = 0.0%" in said
    assert "| right link of faults that open | at least 85 % | 2 of 4 = 50.0%" in said
    assert "| right hypothesis of faults that open |  | 1 of 4 = 25.0%" in said
    assert "| no sure wrong name where the link is not right | at least 90 % | 1 of 2" in said
    assert "| refused recordings |  | 1 of 8" in said
    assert "| `cables` | 1 of 3 = 33.3%" in said
    assert "no run can be used" in line_of(refused)
    assert tables([])
