"""The comparison from its command line: paired, the same for any worker count, taught errors."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from loose_env.evaluation import read_rows
from scripts.agents import compare

ARGUMENTS = json.dumps({"durations": [0.2], "max_records": 3})
FAST = ["--arguments", ARGUMENTS, "--episodes", "5", "--shard", "2", "--seed", "3"]
FAST += ["--rows", "json"]


def run(tmp_path: Path, *options: str, name: str = "out") -> list[dict[str, Any]]:
    out = tmp_path / name
    compare.main([*FAST, "--out", str(out), *options])
    return read_rows(out / "rows.json")[0]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A comparison with all it makes."""
    pytest.importorskip("jinja2")
    pytest.importorskip("matplotlib")
    out = tmp_path_factory.mktemp("compare")
    options = ["--agents", "random", "classical", "--workers", "1", "--curve", "2", "--page"]
    compare.main([*FAST, "--out", str(out), *options])
    return out


def test_agents_meet_the_same_arms(whole: Path) -> None:
    rows, configuration = read_rows(whole / "rows.json")
    hidden = ("seed", "episode", "truth", "gap", "friction", "friction_ratio", "direction")
    by_agent = {
        agent: [[row[name] for name in hidden] for row in rows if row["agent"] == agent]
        for agent in ("random", "classical")
    }
    assert by_agent["random"] == by_agent["classical"]
    assert [row[1] for row in by_agent["random"]] == list(range(5))
    assert configuration["engine"] == "mujoco"
    assert configuration["settings"]["durations"] == [0.2]


def test_agents_that_may_not_stop_take_every_record(whole: Path) -> None:
    rows, _ = read_rows(whole / "curve.json")
    assert [row["agent"] for row in rows] == ["random"] * 5  # the other has no stopping rule
    assert {row["records"] for row in rows} == {2}
    assert all(len(row["trail_best"]) == 2 for row in rows)


def test_a_dataset_holds_the_steps_of_the_rows(tmp_path: Path) -> None:
    file = tmp_path / "steps.npz"
    rows = run(tmp_path, "--agents", "random", "always_healthy", "--dataset", str(file))
    found = np.load(file)
    ends = found["episode_ends"]
    returns = np.add.reduceat(found["rewards"], [0, *ends[:-1]])
    np.testing.assert_allclose(returns, [row["reward"] for row in rows])
    assert found["terminals"][ends - 1].all() and found["terminals"].sum() == len(rows)
    following = found["next_observations"][:-1][~found["terminals"][:-1]]
    np.testing.assert_array_equal(following, found["observations"][1:][~found["terminals"][:-1]])
    with pytest.raises(SystemExit):
        run(tmp_path, "--agents", "random", "--dataset", "steps.csv")


def test_the_page_says_how_to_make_it_again(whole: Path) -> None:
    page = (whole / "index.html").read_text(encoding="utf-8")
    assert "--agents random classical" in page
    assert "Simulated by MuJoCo" in page
    assert "return less that of classical on the same arms" in page
    assert list((whole / "shards").iterdir()) == []


def test_rows_are_the_same_for_any_worker_count_and_shard(whole: Path, tmp_path: Path) -> None:
    pytest.importorskip("joblib")
    expected = [row for row in read_rows(whole / "rows.json")[0] if row["agent"] == "random"]
    threads = run(tmp_path, "--agents", "random", "--backend", "threading", "--workers", "2")
    assert threads == expected
    narrow = ["--agents", "random", "--workers", "1", "--shard", "5"]
    assert run(tmp_path, *narrow, name="b") == expected


def test_an_interrupted_comparison_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from loose_agents import sharded_play as evaluation_shards

    played: list[int] = []
    real = evaluation_shards.evaluate_shard

    def counted(task: Any, span: range, progress: Any = None) -> Any:
        if len(played) == 1:
            raise KeyboardInterrupt
        played.append(span.start)
        return real(task, span, progress)

    monkeypatch.setattr(evaluation_shards, "evaluate_shard", counted)
    with pytest.raises(SystemExit) as stopped:
        run(tmp_path, "--agents", "classical", "--workers", "1")
    assert stopped.value.code == 130
    played.append(-1)  # no second interruption
    rows = run(tmp_path, "--agents", "classical", "--workers", "1")
    assert played == [0, -1, 2, 4]
    assert [row["episode"] for row in rows] == list(range(5))
    assert np.isfinite([row["reward"] for row in rows]).all()
