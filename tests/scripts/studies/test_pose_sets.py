"""The study of pose sets runs, resumes, and gives the same rows whoever works on it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from loose_agents.execution.study import MARKS, ClusterRun, write_between
from loose_agents.policies.pose_sets import LIMIT, Directions, Records, Task, records_block

from scripts.studies import pose_sets as script

SMALL = Directions(arms=("planar2", "planar3"), sds=(10.0,), cases=6, block=3, poses=3, samples=500)


def worked_out(path: Path, settings: Directions, workers: int = 1) -> list[dict[str, Any]]:
    run = ClusterRun(backend="threading", workers=workers)
    return script.study_of(settings).rows(path, settings, run)


def test_rows_are_the_same_for_any_number_of_workers(tmp_path: Path) -> None:
    one = worked_out(tmp_path / "one.json", SMALL, 1)
    two = worked_out(tmp_path / "two.json", SMALL, 2)
    assert one == two
    assert (tmp_path / "one.json").read_bytes() == (tmp_path / "two.json").read_bytes()


def test_a_run_cut_short_goes_on_where_it_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "rows.json"
    whole = worked_out(path, SMALL, 1)
    stored = json.loads(path.read_text(encoding="utf-8"))
    stored["rows"] = [r for r in stored["rows"] if r["strategy"] != "one joint"]
    path.write_text(json.dumps(stored), encoding="utf-8")
    worked: list[Task] = []
    block = script.directions_block

    def watched(task: Task, settings: Directions) -> list[dict[str, Any]]:
        worked.append(task)
        return block(task, settings)

    monkeypatch.setattr(script, "directions_block", watched)
    assert worked_out(path, SMALL, 1) == whole
    assert {task.strategy for task in worked} == {"one joint"}
    assert len(worked) == 4


def test_the_limit_stands_in_the_rows_and_is_not_passed(tmp_path: Path) -> None:
    settings = Directions(
        arms=("planar4",), sds=(20.0,), cases=300, block=300, poses=3, samples=8000
    )
    whole = script.summed(worked_out(tmp_path / "rows.json", settings, 1))
    limit = script.limit_of(whole, "planar4", 20.0)
    assert limit[0] == pytest.approx(0.25)
    for (_, _, name), row in whole.items():
        if name != LIMIT:
            # Three standard deviations of a share of 300.
            assert (row["right"] / 300 <= limit + 0.087).all(), name


def test_an_untrained_agent_is_left_out_with_a_reason(capsys: pytest.CaptureFixture[str]) -> None:
    settings = Records(arms=("planar2",), learned=("ppo", "classical"))
    assert script.playable(settings) == {"planar2": ["classical"]}
    assert "ppo on planar2 is left out: no trained policy" in capsys.readouterr().err


def test_both_levels_are_drawn_and_printed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--quick", "--cases", "2", "--arm", "planar2", "--learned", "--backend", "threading"]
    script.main([*words, "--workers", "1", "--out", str(tmp_path)])
    printed = capsys.readouterr().out
    assert printed.count("| greedy separation |") == 4
    assert "Simulated records" in printed
    assert (tmp_path / "pose_sets.png").stat().st_size > 10_000
    svg = (tmp_path / "pose_sets.svg").read_bytes()
    script.main([*words, "--level", "--out", str(tmp_path)])  # from the rows alone
    assert capsys.readouterr().out == printed
    assert (tmp_path / "pose_sets.svg").read_bytes() == svg


def test_rows_of_an_unknown_engine_are_refused() -> None:
    with pytest.raises(Exception, match="engine"):
        records_block(
            Task(arm="planar2", strategy="random", first=0, cases=1), Records(engine="other")
        )


def test_tables_go_between_their_marks(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    begin, end = (mark.format("tables") for mark in MARKS)
    page.write_text(f"before\n{begin}\nold\n{end}\nafter\n", encoding="utf-8")
    write_between(page, "new")
    assert page.read_text(encoding="utf-8") == (f"before\n{begin}\n\nnew\n\n{end}\nafter\n")
