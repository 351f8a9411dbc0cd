"""Killed at any moment, a command goes on; a long run stays finite and counts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("sb3_contrib")
pytest.importorskip("safetensors")
pytest.importorskip("yaml")
pytest.importorskip("jinja2")

from scripts.suites.trust import soak as long_run
from scripts.suites.trust.kills import commands, kill_often

pytestmark = pytest.mark.slow

KILLS = 2


@pytest.mark.parametrize("name", ["training", "comparison", "gap", "diagnosis"])
def test_a_killed_command_goes_on_and_ends_as_if_it_had_not_been_killed(
    tmp_path: Path, name: str
) -> None:
    made = commands(tmp_path)[name]
    found = kill_often(made, tmp_path / "killed", kills=KILLS, rng=np.random.default_rng(3))
    assert found.problems == []
    assert found.kills == KILLS and found.runs >= 1


@pytest.mark.parametrize("engine", ["reduced", "mujoco"])
def test_a_round_steps_counts_and_stays_finite(
    monkeypatch: pytest.MonkeyPatch, engine: str
) -> None:
    monkeypatch.setattr(long_run, "ARMS", (("loose_env/Planar-v0", {"n_links": 2}),))
    soak = long_run.Soak()
    for _ in range(2):
        long_run.play_round(soak, engine, 1, steps=4, width=3)
    assert (soak.steps, len(soak.memory)) == (24, 2)
    assert soak.episodes > 0 and soak.diverged.total() == 0
