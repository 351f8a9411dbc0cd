"""The study of pose sets runs, resumes, and gives the same rows whoever works on it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from loose_agents.jobs import BackendSettings

from loose_env.arms import planar, scara
from loose_env.diagnosis import ToolFrames
from scripts.studies import link_finding
from scripts.studies import pose_sets as script
from scripts.studies.pose_sets import LIMIT, Directions, Records, Task
from scripts.study import MARKS, write_between

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
    path = script.path_of(tmp_path, SMALL)
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
def test_the_limit_stands_in_the_rows_and_is_not_passed(tmp_path: Path) -> None:
    settings = Directions(
        arms=("planar4",), sds=(20.0,), cases=300, block=300, poses=3, samples=8000
    )
    whole = script.summed(worked_out(tmp_path, settings, 1))
    limit = script.limit_of(whole, "planar4", 20.0)
    assert limit[0] == pytest.approx(0.25)
    for (_, _, name), row in whole.items():
        if name != LIMIT:
            # Three standard deviations of a share of 300.
            assert (row["right"] / 300 <= limit + 0.087).all(), name


@pytest.mark.slow
def test_an_untrained_agent_is_left_out_with_a_reason(capsys: pytest.CaptureFixture[str]) -> None:
    settings = Records(arms=("planar2",), learned=("ppo", "classical"))
    assert script.playable(settings) == {"planar2": ["classical"]}
    assert "ppo on planar2 is left out: no trained policy" in capsys.readouterr().err


@pytest.mark.slow
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


def test_tables_go_between_their_marks(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    begin, end = (mark.format("tables") for mark in MARKS)
    page.write_text(f"before\n{begin}\nold\n{end}\nafter\n", encoding="utf-8")
    write_between(page, "new")
    assert page.read_text(encoding="utf-8") == (f"before\n{begin}\n\nnew\n\n{end}\nafter\n")


@pytest.mark.slow
def test_a_quick_run_of_link_finding_prints_both_tables(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    link_finding.main(["--quick", "--arm", "planar4", "--out", str(tmp_path / "link_finding.json")])
    printed = capsys.readouterr().out
    assert "scatter 20 degrees" in printed
    assert "(b) simulated" in printed
    assert printed.count("images all") == 5


def test_the_bound_counts_links_that_no_move_tells_apart() -> None:
    assert link_finding.bound(ToolFrames(planar(4)), 20, 0) == 1.0
    # Links 2 and 3 of a SCARA are alike: half of their cases are lost.
    assert link_finding.bound(ToolFrames(scara()), 40, 0) == pytest.approx(0.75)


def test_images_need_fewer_poses_than_turns() -> None:
    right = link_finding.by_scatter(ToolFrames(planar(4)), np.radians(5), 40, 2, 3)
    by_method = dict(zip(link_finding.METHODS, right[:, 1], strict=True))
    assert by_method["images all"] > 0.9
    assert by_method["images all"] > by_method["4.31 outward"] + 0.2
