"""Killed at any moment, a command goes on: nothing half-written counts, no row is lost or doubled.

`python -m scripts.suites.trust.kills_run` kills each 20 times; here a few times.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("sb3_contrib")
pytest.importorskip("safetensors")
pytest.importorskip("yaml")
pytest.importorskip("jinja2")
pytest.importorskip("matplotlib")

from loose_agents.comparison import EvaluationTask, play_task

from loose_env.cli.main import COMMANDS as LOOSE
from scripts.suites.trust.kills import killing
from scripts.suites.trust.kills.commands import commands
from scripts.suites.trust.kills.killing import Command, kill_often
from tests.trust.warm_process import ROOT, WarmProcess

NAMES = ("training", "comparison", "gap", *(("diagnosis",) if "diagnose" in LOOSE else ()))
KILLS = 2
WARM = ("comparison", "gap", "diagnosis")
"""Commands that need not load the large packages each time; the training starts as it is typed."""


@pytest.mark.parametrize("name", NAMES)
def test_a_killed_command_goes_on_and_ends_as_if_it_had_not_been_killed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    if name in WARM:
        monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), str(ROOT / "agents")]))
        monkeypatch.setenv("OMP_NUM_THREADS", "1")
        monkeypatch.setattr(killing, "_popen", WarmProcess)
    command = commands(tmp_path)[name]
    found = kill_often(command, tmp_path / "killed", kills=KILLS, rng=np.random.default_rng(3))
    assert found.problems == []
    assert found.kills == KILLS
    assert found.equal == found.runs >= 1


WRITER = """
import sys, time, pathlib
out = pathlib.Path(sys.argv[1]); out.mkdir(exist_ok=True)
for k in range(4):
    with (out / f"{k}.json").open("w") as file:
        file.write('[1, 2'); file.flush(); time.sleep(0.05); file.write(', 3]')
"""


def test_a_command_that_writes_in_place_is_found_out(tmp_path: Path) -> None:
    def problems(out: Path) -> list[str]:
        found = []
        for file in out.glob("*.json"):
            try:
                json.loads(file.read_text())
            except ValueError:
                found.append(f"{file.name} is cut short")
        return found

    command = Command(
        name="writer",
        words=lambda out: ("-c", WRITER, str(out)),
        problems=problems,
        result=lambda out: sorted(p.name for p in out.iterdir()),
    )
    found = kill_often(command, tmp_path, kills=6, rng=np.random.default_rng(1))
    assert any("cut short" in problem for problem in found.problems)


LATE = """
import sys, time, pathlib
out = pathlib.Path(sys.argv[1]); out.mkdir(exist_ok=True)
time.sleep(0.6)
for k in range(3):
    part = out / f".{k}.part"; part.write_text('{}'); time.sleep(0.05)
    part.replace(out / f"{k}.json"); time.sleep(0.05)
"""


def test_a_command_that_writes_at_its_end_is_killed_between_its_writes_too(tmp_path: Path) -> None:
    command = Command(
        name="late",
        words=lambda out: ("-c", LATE, str(out)),
        problems=lambda out: [],
        result=lambda out: sorted(p.name for p in out.glob("*.json")),
    )
    found = kill_often(command, tmp_path, kills=8, rng=np.random.default_rng(5))
    assert found.problems == []
    assert 4 <= found.after_write <= 8
    assert max(found.moments) > found.events // 2


def test_a_command_whose_result_depends_on_kills_is_found_out(tmp_path: Path) -> None:
    script = (
        "import sys, time, pathlib; out = pathlib.Path(sys.argv[1]); out.mkdir(exist_ok=True)\n"
        "for k in range(5):\n"
        "    file = out / 'rows'; file.open('a').write(f'{k}\\n'); time.sleep(0.05)\n"
    )
    command = Command(
        name="appender",
        words=lambda out: ("-c", script, str(out)),
        problems=lambda out: [],
        result=lambda out: (out / "rows").read_text(),
    )
    found = kill_often(command, tmp_path, kills=4, rng=np.random.default_rng(2))
    assert any("another result" in problem for problem in found.problems)


def test_a_run_killed_while_it_tidies_up_plays_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import loose_agents.comparison as shards

    task = EvaluationTask(
        agent="random",
        env_id="loose_env/Planar-v0",
        arguments={"n_links": 2, "durations": [0.2], "max_records": 2},
        count=2,
        seed=1,
        width=2,
    )
    rmtree = shards.shutil.rmtree

    def killed(folder: Path, ignore_errors: bool = False) -> None:
        if not Path(folder).exists():
            return
        (Path(folder) / "configuration.json").unlink()  # the first of the files to go
        raise KeyboardInterrupt

    monkeypatch.setattr(shards.shutil, "rmtree", killed)
    with pytest.raises(KeyboardInterrupt):
        play_task(task, tmp_path)
    monkeypatch.setattr(shards.shutil, "rmtree", rmtree)
    rows = play_task(task, tmp_path)
    assert [row["episode"] for row in rows] == [0, 1]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("where", "stays"), [("diagnose_residuals", True), ("render_gap_page", False)]
)
def test_no_old_result_stands_beside_a_new_model(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, where: str, stays: bool
) -> None:
    """It goes with the first file that changes; until then it is that of the model beside it."""
    from loose_env.gap.workflow import summary
    from loose_env.report import gap as report

    def killed(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    tmp_path.joinpath("result.json").write_text("of an earlier run")
    for module, name in (
        (summary, "diagnose_residuals"),
        (summary, "_with_probabilities"),
        (summary, "result_of"),
        (report, "render_gap_page"),
    ):
        monkeypatch.setattr(module, name, killed if name == where else lambda *_, **__: None)
    found: Any = SimpleNamespace(problem=None)
    with pytest.raises(KeyboardInterrupt):
        summary.write_gap(tmp_path, found, report=report.write_gap_report)
    assert tmp_path.joinpath("result.json").exists() is stays
    assert not list(tmp_path.glob("*.part"))
