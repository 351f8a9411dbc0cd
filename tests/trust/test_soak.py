"""The long run counts what it steps, finds what grows and what diverges, and goes on."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np
import pytest

import scripts.suites.trust.soak_run as trust_soak
from scripts.suites.trust.soak_run import ARMS, MOST_GROWTH, Soak, memory, play_round, words


@pytest.mark.parametrize("engine", ["reduced", "mujoco"])
def test_a_round_steps_counts_and_stays_finite(
    engine: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(trust_soak, "ARMS", (("loose_env/Planar-v0", {"n_links": 2}),))
    soak = Soak(engine=engine, memory=[[]])
    for _ in range(2):
        play_round(soak, 1, steps=4, width=3)
    assert (soak.steps, soak.rounds) == (24, 2)
    assert 0 < soak.records <= 24 and soak.episodes > 0
    assert len(soak.memory[0]) == 2
    assert sum(soak.diverged.values()) == 0
    assert Soak(**asdict(soak)) == soak


def test_rounds_are_the_same_however_often_the_run_was_stopped(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(trust_soak, "ARMS", (("loose_env/Planar-v0", {"n_links": 2}),))
    whole, first = (Soak(engine="mujoco", memory=[[]]) for _ in range(2))
    for _ in range(2):
        play_round(whole, 1, steps=3, width=2)
    play_round(first, 1, steps=3, width=2)
    second = Soak(**asdict(first))
    second.memory.append([])
    play_round(second, 1, steps=3, width=2)
    assert (second.steps, second.records, second.episodes) == (
        whole.steps,
        whole.records,
        whole.episodes,
    )


def test_growth_is_found_and_noise_is_not() -> None:
    steady = [100.0] * len(ARMS) + [100.0 + (k % 3) for k in range(100)]
    assert abs(Soak(engine="reduced", memory=[steady]).growth) < MOST_GROWTH / 2
    growing = [100.0 + 0.1 * k for k in range(105)]
    found = Soak(engine="reduced", memory=[[100.0], growing])
    assert found.growth > MOST_GROWTH
    assert "growth +7.89%" in words(found)


def test_what_is_not_finite_ends_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    from loose_env.envs import DiagnosisVectorEnv

    step = DiagnosisVectorEnv.step

    def broken(self: DiagnosisVectorEnv, actions: Any) -> Any:
        observation, *rest = step(self, actions)
        return observation * np.nan, *rest

    monkeypatch.setattr(DiagnosisVectorEnv, "step", broken)
    monkeypatch.setattr(trust_soak, "ARMS", (("loose_env/Planar-v0", {"n_links": 2}),))
    with pytest.raises(ValueError, match="round 0: a value is not finite"):
        play_round(Soak(engine="mujoco", memory=[[]]), 1, steps=1, width=1)


def test_diverged_simulations_are_counted_by_arm(monkeypatch: pytest.MonkeyPatch) -> None:
    from loose_env.envs import DiagnosisVectorEnv

    counted = property(lambda self: {"backlash": 2})
    monkeypatch.setattr(DiagnosisVectorEnv, "divergences", counted)
    monkeypatch.setattr(trust_soak, "ARMS", (("loose_env/Planar-v0", {"n_links": 2}),))
    soak = Soak(engine="mujoco", memory=[[]])
    for _ in range(2):
        play_round(soak, 1, steps=1, width=1)
    assert soak.diverged == {"Planar-v0 backlash": 4}
    assert "Planar-v0 backlash 4" in words(soak)


def test_memory_is_that_of_the_process() -> None:
    before = memory()
    held = np.ones(40 * 2**17)  # 40 MB
    assert 30 < memory() - before < 60
    assert held.sum() > 0
