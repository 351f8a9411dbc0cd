"""The examples on the documentation's pages run as they are printed."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

from loose_env.gap.catalogue import CATALOGUE
from loose_env.gap.machine import Machine
from tests.gap.effect_arms import PLANAR

ROOT = Path(__file__).resolve().parents[2]
UR5E = ROOT.parent / "shared" / "models" / "ur5e_bare.xml"
BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)


def blocks(page: Path) -> str:
    return "\n".join(BLOCK.findall(page.read_text(encoding="utf-8")))


@pytest.mark.skipif(not UR5E.is_file(), reason=f"needs the UR5e file at {UR5E}")
def test_from_a_model_file_to_a_loose_link(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "ur5e.xml").write_bytes(UR5E.read_bytes())
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    exec(compile(blocks(ROOT / "docs" / "your_arm.md"), "your_arm.md", "exec"), names)
    printed = capsys.readouterr().out
    assert "shoulder_pan_joint" in printed
    assert "structural_looseness@link3, along" in printed
    posterior, hidden = names["posterior"], names["hidden"]
    direction = posterior.directions[2]  # type: ignore[attr-defined]
    true = np.array(hidden.direction) / np.linalg.norm(hidden.direction)  # type: ignore[attr-defined]
    whole = names["whole"]
    assert whole.place == "structural_looseness@link3"  # type: ignore[attr-defined]
    for found in (direction, whole.direction_in_link):  # type: ignore[attr-defined]
        assert np.degrees(np.arccos(min(1.0, abs(float(found @ true))))) < 10.0


def test_the_examples_in_space() -> None:
    code = blocks(ROOT / "docs" / "space.md")
    names: dict[str, object] = {}
    exec(compile(code, "space.md", "exec"), names)
    assert "rotational_looseness@link6" in names["env"].unwrapped.hypotheses  # type: ignore[attr-defined]


def test_the_table_of_sensors_is_the_stored_study(capsys: pytest.CaptureFixture[str]) -> None:
    from scripts.study_sensors import main

    main(["--show", str(ROOT / "docs" / "figures" / "sensors_number.json")])
    page = (ROOT / "docs" / "space.md").read_text(encoding="utf-8")
    for line in capsys.readouterr().out.splitlines():
        assert line.rstrip() in page


def test_the_readme(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    exec(compile(BLOCK.findall((ROOT / "README.md").read_text())[0], "README.md", "exec"), names)
    info = names["info"]
    assert isinstance(info, dict)
    assert "is_success" in info


def test_the_effect_of_the_gap_page_is_one_and_acts() -> None:
    text = (ROOT / "docs" / "gap.md").read_text(encoding="utf-8")
    code = next(each for each in BLOCK.findall(text) if "@register" in each)
    before = dict(CATALOGUE)
    try:
        exec(compile(code, "gap.md", "exec"), {"__name__": "gap"})
        machine = Machine(mujoco.MjSpec.from_string(PLANAR))
        effect = CATALOGUE["gravity_compensation"](machine, "link2")
        spec = machine.fresh()
        effect.edit(spec, np.array([1.0]))
        torques = []
        for each in (machine.fresh(), spec):
            model = each.compile()
            data = mujoco.MjData(model)
            mujoco.mj_forward(model, data)
            torques.append((data.qfrc_bias - data.qfrc_gravcomp)[1])
        weight = 3 * 9.81 * 0.16
        assert np.isclose(torques[0] - torques[1], weight, rtol=1e-6)
    finally:
        CATALOGUE.clear()
        CATALOGUE.update(before)
