"""The step-by-step example of the page on gaps, on the recording that the page makes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import pytest

from loose_env.gap.model.effects.catalogue import CATALOGUE
from loose_env.recording import read_recording
from tests.docs.pages import ROOT, blocks
from tests.docs.test_examples import a_gap_recording


def test_step_by_step_finds_the_friction_and_keeps_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    a_gap_recording(tmp_path, monkeypatch)
    monkeypatch.chdir(tmp_path)
    (code,) = (b.text for b in blocks(ROOT / "docs" / "gap.md") if "GapSession(" in b.text)
    names: dict[str, Any] = {"recording": read_recording("recordings/arm")}
    exec("from loose_env.gap.settings import GapSettings", names)
    exec(compile(code, "gap.md", "exec"), names)
    tried, steps = names["tried"], names["steps"]
    assert tried.accepted and tried.held_out < 0.5 * tried.before
    assert abs(tried.parameters["torque"] - 2.0) < 0.2
    assert [effect.kind for effect in steps.added] == ["coulomb_friction"]
    assert "coulomb_friction@joint2: torque" in capsys.readouterr().out
    assert mujoco.MjModel.from_xml_path("corrected.xml").dof_frictionloss[1] > 1.8


def test_the_readme_counts_the_catalogue() -> None:
    assert f"screens {len(CATALOGUE)} effects" in (ROOT / "README.md").read_text()
