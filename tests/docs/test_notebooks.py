"""The notebooks of the documents run from top to bottom, and show what they say."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("nbformat", reason="needs the extra dev: pip install -e '.[dev]'")
pytest.importorskip("nbclient")
pytest.importorskip("ipykernel")

import nbclient
import nbformat

from scripts import example_recording
from tests.docs.pages import ROOT

pytestmark = pytest.mark.slow

SECONDS = 300
"""Longest time that a cell may take [s]."""


def shown(cell: Any) -> list[dict[str, str]]:
    """Outputs of a cell, by media type."""
    return [each["data"] for each in cell.outputs if "data" in each]


def executed(notebook: Path, folder: Path) -> list[Any]:
    """Code cells of a notebook that was run in a folder."""
    found = nbformat.read(notebook, as_version=4)
    nbformat.validate(found)
    client = nbclient.NotebookClient(
        found, timeout=SECONDS, kernel_name="python3", resources={"metadata": {"path": str(folder)}}
    )
    client.execute()
    return [cell for cell in found.cells if cell.cell_type == "code"]


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the recordings that the notebooks read."""
    for name in ("IPYTHONDIR", "JUPYTER_CONFIG_DIR", "JUPYTER_RUNTIME_DIR"):
        monkeypatch.setenv(name, str(tmp_path / ".jupyter"))
    path = [str(ROOT), os.environ.get("PYTHONPATH", "")]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, path)))
    example_recording.loose_arm(tmp_path / "session" / "recording", seed=1)
    monkeypatch.setattr(example_recording, "SECONDS", 1.0)
    example_recording.example(tmp_path / "arm", seed=1)
    return tmp_path


def test_the_three_lines_show_the_loose_link_and_the_missing_friction(home: Path) -> None:
    three, values, gap, written = executed(ROOT / "docs/notebooks/three_lines.ipynb", home)
    assert len([line for line in three.source.splitlines() if line]) == 3
    (diagnosis,) = shown(three)
    assert "<strong>The seat of link3 is loose.</strong>" in diagnosis["text/html"]
    assert "<table>" in diagnosis["text/html"]
    assert diagnosis["text/plain"].startswith("The seat of link3 is loose.\n")
    assert "'link3'" in shown(values)[0]["text/plain"]
    assert "dry friction (joint2)" in shown(gap)[0]["text/html"]
    assert "model.xml" in shown(written)[0]["text/plain"]
    assert (home / "arm-gap" / "result.json").is_file()
