"""Killed at any moment, a command goes on; a long run counts, and finds what grows."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("sb3_contrib")
pytest.importorskip("safetensors")
pytest.importorskip("yaml")
pytest.importorskip("jinja2")

from scripts.suites.trust import soak as long_run
from scripts.suites.trust.kills import Command, commands, kill_often
from scripts.suites.trust.soak import ARMS, MOST_GROWTH, Soak, memory, play_round

KILLS = 2


@pytest.mark.slow
@pytest.mark.parametrize("name", ["training", "comparison", "gap", "diagnosis"])
def test_a_killed_command_goes_on_and_ends_as_if_it_had_not_been_killed(
    tmp_path: Path, name: str
) -> None:
    made = commands(tmp_path)[name]
    found = kill_often(made, tmp_path / "killed", kills=KILLS, rng=np.random.default_rng(3))
    assert found.problems == []
    assert found.kills == KILLS and found.runs >= 1


IN_PLACE = """
import sys, time, pathlib
out = pathlib.Path(sys.argv[1]); out.mkdir(exist_ok=True)
for k in range(4):
    with (out / f"{k}.json").open("w") as file:
        file.write('[1, 2'); file.flush(); time.sleep(0.05); file.write(', 3]')
"""
APPENDING = """
import sys, time, pathlib
out = pathlib.Path(sys.argv[1]); out.mkdir(exist_ok=True)
for k in range(5):
    (out / 'rows').open('a').write(f'{k}\\n'); time.sleep(0.05)
"""


def cut_short(out: Path) -> list[str]:
    found = []
    for file in out.glob("*.json"):
        try:
            json.loads(file.read_text())
        except ValueError:
            found.append(f"{file.name} is cut short")
    return found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("script", "problem"), [(IN_PLACE, "cut short"), (APPENDING, "another result")]
)
def test_a_command_that_leaves_halves_or_doubles_is_found_out(
    tmp_path: Path, script: str, problem: str
) -> None:
    made = Command(
        words=lambda out: ("-c", script, str(out)),
        problems=cut_short,
        result=lambda out: [p.read_text() for p in sorted(out.iterdir())],
    )
    found = kill_often(made, tmp_path, kills=6, rng=np.random.default_rng(1))
    assert any(problem in each for each in found.problems)


@pytest.fixture
def one_arm(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(long_run, "ARMS", (("loose_env/Planar-v0", {"n_links": 2}),))


@pytest.mark.usefixtures("one_arm")
@pytest.mark.parametrize("engine", ["reduced", "mujoco"])
def test_a_round_steps_counts_and_stays_finite(engine: str) -> None:
    soak = Soak()
    for _ in range(2):
        play_round(soak, engine, 1, steps=4, width=3)
    assert (soak.steps, len(soak.memory)) == (24, 2)
    assert soak.episodes > 0 and soak.diverged.total() == 0


@pytest.mark.usefixtures("one_arm")
def test_what_is_not_finite_ends_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    from loose_env.envs import DiagnosisVectorEnv

    step = DiagnosisVectorEnv.step

    def broken(self: DiagnosisVectorEnv, actions: Any) -> Any:
        observation, *rest = step(self, actions)
        return observation * np.nan, *rest

    monkeypatch.setattr(DiagnosisVectorEnv, "step", broken)
    with pytest.raises(AssertionError, match="round 0: a value is not finite"):
        play_round(Soak(), "mujoco", 1, steps=1, width=1)


def test_growth_is_found_and_noise_is_not() -> None:
    steady = [100.0] * len(ARMS) + [100.0 + (k % 3) for k in range(100)]
    assert abs(Soak(memory=steady).growth) < MOST_GROWTH / 2
    found = Soak(memory=[100.0 + 0.1 * k for k in range(105)])
    assert found.growth > MOST_GROWTH and "growth +7.89%" in str(found)
    before = memory()
    held = np.ones(40 * 2**17)  # 40 MB
    assert 30 < memory() - before < 60 and held.sum() > 0
