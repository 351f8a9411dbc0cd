"""Logs as users have them are guessed and imported rightly, or refused with what to do."""

from __future__ import annotations

from pathlib import Path

import pytest

from scripts.suites.logs import LOGS, Log, made, tried

CASES = Path(__file__).resolve().parents[4] / "shared" / "cases"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The cases with their files made."""
    if not CASES.is_dir():
        pytest.skip("the cases are no part of the repository")
    place = tmp_path_factory.mktemp("cases")
    made(CASES, place)
    return place


@pytest.mark.parametrize("log", LOGS, ids=lambda log: f"{log.case}-{log.files[0]}")
def test_a_log_ends_as_it_should(log: Log, folder: Path) -> None:
    outcome, why = tried(log, folder)
    assert outcome.startswith("right"), why
