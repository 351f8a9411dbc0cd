"""A folder with an arm and a mapping, and the command line on it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.importing.sample_files import ARM


@pytest.fixture
def home(tmp_path: Path) -> Path:
    """A folder with ``arm.xml``."""
    tmp_path.joinpath("arm.xml").write_text(ARM)
    return tmp_path


@pytest.fixture
def mapping(home: Path) -> Callable[[str], Path]:
    """Write a mapping of the arm: its text without the first two lines."""

    def write(text: str, name: str = "map.toml") -> Path:
        path = home / name
        path.write_text(f'format = "loose-mapping/1"\nmodel = "arm.xml"\n{text}')
        return path

    return write
