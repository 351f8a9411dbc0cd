"""The examples on the documentation's pages run as they are printed."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from loose_env.arms import DESK_ARM
from loose_env.gap.model.effects.catalogue import CATALOGUE
from loose_env.importing import read_mapping
from loose_env.recording import read_recording
from scripts.example_recording import loose_arm
from tests.docs.pages import PAGES, ROOT, blocks, python
from tests.importing.sample_files import ARM, motion


def a_shaken_arm(folder: Path) -> None:
    """A model file, and the recording that pages diagnose."""
    shutil.copy(DESK_ARM, folder / "ur5e.xml")
    loose_arm(folder / "session" / "recording")


PREPARED: dict[str, Callable[[Path], None]] = {"README.md": a_shaken_arm}
"""What has to be there before a page's examples run."""
FEWER: dict[str, dict[str, str]] = {
    "agents.md": {
        "arms = 50": "arms = 8",
        "num_envs=128": "num_envs=8",
        "n_eval_episodes=64": "n_eval_episodes=4",
        "learn(4096)": "learn(128)",
        "num, length, updates, rate = 64, 32, 3": "num, length, updates, rate = 8, 32, 1",
    },
    "environments.md": {
        "arms, n, iterations, adaptive = 256, 3, 3": "arms, n, iterations, adaptive = 16, 3, 2",
    },
}
"""Counts of a page's examples -> those of the test, which learns nothing but runs every line."""
OWN = ("gap.md", "getting_started.md", "instrument.md", "method.md", "recordings.md")
"""Pages whose examples have a test of their own below, which looks at what comes out."""


@pytest.fixture(autouse=True)
def own_catalogue() -> Any:
    """Effects that a page registers are forgotten again."""
    before = dict(CATALOGUE)
    yield
    CATALOGUE.clear()
    CATALOGUE.update(before)


def run(page: Path, change: Callable[[str], str] = str) -> dict[str, Any]:
    """Run a page's examples in the present folder; return the names they leave."""
    names: dict[str, Any] = {"__name__": page.stem}
    exec(compile(change(python(page)), str(page), "exec"), names)
    return names


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(p, marks=pytest.mark.slow) if p.name == "README.md" else p
        for p in PAGES
        if p.name not in OWN and any(b.language == "python" for b in blocks(p))
    ],
    ids=lambda page: page.name,
)
def test_examples_run(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    PREPARED.get(page.name, lambda folder: None)(tmp_path)
    monkeypatch.chdir(tmp_path)

    def fewer(code: str) -> str:
        for printed, own in FEWER.get(page.name, {}).items():
            assert printed in code
            code = code.replace(printed, own)
        return code

    run(page, fewer)


def test_code_says_its_language() -> None:
    """What looks like Python is marked as Python, and so is run."""
    for page in PAGES:
        for block in blocks(page):
            looks = re.search(
                r"^(from \S+ import|import \S+$|\w+ = \w+\()", block.text, re.MULTILINE
            )
            assert block.language or not looks, f"{page.name}, line {block.line}"


def test_getting_started_finds_the_fault(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    names = run(ROOT / "docs" / "getting_started.md")
    assert names["info"]["is_success"] and float(names["probabilities"].max()) > 0.9
    assert "structural_looseness@link2 was right" in capsys.readouterr().out


def test_the_method_finds_the_loose_link(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    names = run(ROOT / "docs" / "method.md")
    assert "structural_looseness@link3, along" in capsys.readouterr().out
    pool, hidden = names["pool"], names["hidden"]
    true = np.array(hidden.direction) / np.linalg.norm(hidden.direction)
    direction = pool.directions[names["best"]]
    assert np.degrees(np.arccos(min(1.0, abs(float(direction @ true))))) < 10.0


@pytest.mark.slow
def test_the_instrument_page_finds_the_loose_link(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    a_shaken_arm(tmp_path)
    monkeypatch.chdir(tmp_path)
    found = run(ROOT / "docs" / "instrument.md")["found"]
    assert found.places[0].at == "link3" and found.places[0].verdict == "loose"


@pytest.mark.slow
def test_the_gap_page_finds_the_friction_and_its_effects_act(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from scripts import example_recording

    monkeypatch.setattr(example_recording, "SECONDS", 1.0)
    example_recording.example(tmp_path / "recordings" / "arm", seed=1)
    monkeypatch.chdir(tmp_path)
    # The whole catalogue takes a while; the page says how to ask for a part of it.
    part = 'GapSettings(kinds=("coulomb_friction",), simulate=False, threads=1)'
    names = run(ROOT / "docs" / "gap.md", lambda code: code.replace("GapSettings()", part))
    printed = capsys.readouterr().out
    assert re.search(r"^coulomb_friction joint2 ", printed, re.MULTILINE)
    answer = names["answer"]
    (found,) = [finding for finding in answer.decision.findings if finding.named]
    assert found.term.name == ("coulomb_friction", "joint2") and abs(found.values[0] - 2.0) < 0.2
    assert names["tried"].doubt and re.search(r"'hardening_spring'.* doubt='\w+", printed)
    assert mujoco.MjModel.from_xml_path("arm-gap/model.xml").dof_frictionloss[1] > 1.8
    # The balancer carries all of a link's weight.
    machine = answer.selection.evidence.balance.machine
    spec = machine.fresh()
    CATALOGUE["balancer"](machine, machine.links[-1]).edit(spec, np.array([1.0]))
    for model, weightless in ((machine.fresh().compile(), False), (spec.compile(), True)):
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        torque = (data.qfrc_bias - data.qfrc_gravcomp)[-1]
        assert np.isclose(torque, 0.0, atol=1e-9) is np.bool_(weightless)


def test_the_page_s_files_become_a_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    page = ROOT / "docs" / "recordings.md"
    (printed,) = (b.text for b in blocks(page) if b.text.startswith("Logger 5"))
    mapping = next(b.text for b in blocks(page) if b.language == "toml")
    monkeypatch.chdir(tmp_path)
    time = np.arange(1000) / 1000
    signals = motion(time)
    rows = np.stack([time * 1e3, np.degrees(signals["elbow"]), *(signals[a] for a in "xyz")], 1)
    lines = printed.splitlines()[:2]
    lines += [";".join(f"{v:.9f}".replace(".", ",") for v in row) for row in rows]
    Path("daq.csv").write_text("\n".join(lines) + "\n")
    Path("arm.xml").write_text(ARM)
    Path("mapping.toml").write_text(mapping)
    run(page)
    assert "pose-1.parquet 801" in capsys.readouterr().out
    imported = read_recording("recording").runs[0]
    tool = 98.0665 * np.stack([signals["x"], signals["z"], -signals["y"]], 1)
    np.testing.assert_allclose(imported.sensors["tool"], tool[100:901], atol=1e-6)


def test_the_page_s_pieces_of_mappings_are_read(tmp_path: Path) -> None:
    texts = [b.text for b in blocks(ROOT / "docs" / "recordings.md") if b.language == "toml"]
    (tmp_path / "mapping.toml").write_text("".join(texts))
    found = read_mapping(tmp_path / "mapping.toml")
    assert found.runs[1].pose == {"elbow": 0.52}
