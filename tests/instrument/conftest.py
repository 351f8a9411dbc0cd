"""Sessions of the bench arm that several files of tests judge."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from loose_env.instrument import PlanSettings, plan
from loose_env.recording import Recording
from tests.instrument.machine import NOMINAL, Truth, session

Play = Callable[..., Recording]


@pytest.fixture(scope="session")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Model file of the bench arm."""
    path = tmp_path_factory.mktemp("bench") / "bench.xml"
    path.write_text(NOMINAL)
    return path


@pytest.fixture(scope="session")
def play(bench: Path, tmp_path_factory: pytest.TempPathFactory) -> Play:
    """Plan a session of three poses for the bench arm, play it, and write its recording."""

    def played(truth: Truth, *, seed: int = 0, reference: bool = False) -> Recording:
        made, arm = plan(bench, PlanSettings(poses=3, reference=reference))
        home = tmp_path_factory.mktemp("session")
        before = Truth(mode_hz=truth.mode_hz)
        return session(home, made, arm, truth, seed=seed, before=before)

    return played
