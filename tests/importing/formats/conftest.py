"""A folder with the arm of these tests, and its motion."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.importing.formats.arm_log import ARM, Motion, moved


@pytest.fixture
def motion() -> Motion:
    return moved()


@pytest.fixture
def home(tmp_path: Path) -> Path:
    """A folder with ``arm.xml``."""
    tmp_path.joinpath("arm.xml").write_text(ARM)
    return tmp_path
