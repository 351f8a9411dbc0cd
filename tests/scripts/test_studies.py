"""The study of pose sets runs, resumes, and gives the same rows whoever works on it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from loose_agents.jobs import BackendSettings

from scripts.studies import pose_sets as script
from scripts.studies.pose_sets import Directions, Task

SMALL = Directions(arms=("planar2",), sds=(10.0,), cases=4, block=2, poses=2, samples=200)


def worked_out(folder: Path, settings: Directions, workers: int = 1) -> list[dict[str, Any]]:
    backend = BackendSettings(backend="threading", workers=workers)
    return script.rows_of(folder, settings, backend)


@pytest.mark.slow
def test_rows_are_the_same_for_any_number_of_workers(tmp_path: Path) -> None:
    one, two = (worked_out(tmp_path / str(count), SMALL, count) for count in (1, 2))
    assert one == two
    name = "pose_sets_directions.json"
    assert (tmp_path / "1" / name).read_bytes() == (tmp_path / "2" / name).read_bytes()


@pytest.mark.slow
def test_a_run_cut_short_goes_on_where_it_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = worked_out(tmp_path, SMALL, 1)
    path = tmp_path / script.ROWS
    stored = json.loads(path.read_text(encoding="utf-8"))
    stored["rows"] = [r for r in stored["rows"] if r["strategy"] != "one joint"]
    path.write_text(json.dumps(stored), encoding="utf-8")
    worked: list[Task] = []
    block = script.directions_block

    def watched(task: Task, settings: Directions) -> list[dict[str, Any]]:
        worked.append(task)
        return block(task, settings)

    monkeypatch.setattr(script, "directions_block", watched)
    assert worked_out(tmp_path, SMALL, 1) == whole
    assert {task.strategy for task in worked} == {"one joint"}
    assert len(worked) == 2


def test_a_block_has_a_row_for_each_scatter() -> None:
    task = Task(arm="planar2", strategy="random", first=0, cases=2)
    (row,) = script.directions_block(task, SMALL)
    assert (row["strategy"], row["sd"], row["cases"]) == ("random", 10.0, 2)


@pytest.mark.slow
def test_the_study_is_drawn_and_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--quick", "--cases", "2", "--arm", "planar2", "--backend", "threading"]
    script.main([*words, "--workers", "1", "--out", str(tmp_path)])
    printed = capsys.readouterr().out
    assert printed.count("| greedy separation |") == 3
    picture = (tmp_path / "pose_sets.png").read_bytes()
    assert len(picture) > 10_000
    script.main([*words, "--stored", "--out", str(tmp_path)])  # from the rows alone
    assert capsys.readouterr().out == printed
    assert (tmp_path / "pose_sets.png").read_bytes() == picture
