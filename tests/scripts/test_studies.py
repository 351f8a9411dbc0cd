"""The study of pose sets runs, resumes, and gives the same rows whoever works on it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from loose_agents.jobs import BackendSettings

from loose_env.errors import InvalidSetting
from scripts.studies import pose_sets as script
from scripts.studies.pose_sets import Directions, Task

SMALL = Directions(poses=2, samples=200)
TASKS = script.tasks_of(("planar2",), 4)


def worked_out(folder: Path, workers: int = 1) -> list[dict[str, Any]]:
    return script.rows_of(
        folder, TASKS, SMALL, BackendSettings(backend="threading", workers=workers)
    )


@pytest.mark.slow
def test_rows_are_the_same_for_any_number_of_workers_and_a_run_cut_short_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = worked_out(tmp_path)
    assert whole == worked_out(tmp_path / "two", workers=2)
    path = tmp_path / script.ROWS
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    path.write_text("".join(line for line in lines if "one joint" not in line) + '{"cut')
    worked: list[Task] = []
    block = script.directions_block

    def watched(task: Task, settings: Directions) -> dict[str, Any]:
        worked.append(task)
        return block(task, settings)

    monkeypatch.setattr(script, "directions_block", watched)
    assert worked_out(tmp_path) == whole
    assert {task.strategy for task in worked} == {"one joint"} and len(worked) == 3
    with pytest.raises(InvalidSetting, match="rows of other code or settings"):
        script.rows_of(tmp_path, TASKS, replace(SMALL, seed=1), BackendSettings())


def test_a_block_counts_right_links_after_each_pose() -> None:
    row = script.directions_block(Task("planar2", "random", 10.0, 0, 2), SMALL)
    assert (row["strategy"], row["sd"], row["cases"], len(row["right"])) == ("random", 10.0, 2, 2)


@pytest.mark.slow
def test_the_study_is_drawn_and_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--quick", "--cases", "2", "--arm", "planar2", "--backend", "threading"]
    script.main([*words, "--workers", "1", "--out", str(tmp_path)])
    printed = capsys.readouterr().out
    assert printed.count("| greedy separation |") == 3
    picture = (tmp_path / "pose_sets.png").read_bytes()
    assert len(picture) > 10_000
    script.main([*words, "--stored", "--out", str(tmp_path)])  # from the rows alone
    assert printed.endswith(capsys.readouterr().out)
    assert (tmp_path / "pose_sets.png").read_bytes() == picture
