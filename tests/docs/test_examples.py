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
from loose_env.gap import GapSettings
from loose_env.gap.model.effects.catalogue import CATALOGUE
from loose_env.gap.model.nominal_model import NominalModel
from scripts.example_recording import loose_arm
from tests.docs.pages import PAGES, ROOT, blocks, python
from tests.gap.cases.effect_arms import PLANAR

UR5E = ROOT.parent / "shared" / "models" / "ur5e_bare.xml"
OWN = {
    "your_arm.md": "test_examples.py",
    "gap.md": "test_examples.py",
    "importing.md": "test_importing.py",
    "real_arm.md": "test_examples.py",
}
"""Pages whose examples have a test of their own, which looks at what comes out, and its file."""


def a_gap_recording(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What the page on gaps reads: the example's recording, shortened."""
    from scripts import example_recording

    monkeypatch.setattr(example_recording, "SECONDS", 1.0)
    example_recording.example(folder / "recordings" / "arm", seed=1)


def corrected_models(folder: Path) -> None:
    """The files that the page on corrected models names."""
    for name in ("DIR/model.xml", "nominal.xml", "true.xml"):
        (folder / name).parent.mkdir(exist_ok=True)
        shutil.copy(DESK_ARM, folder / name)


def some_arm(folder: Path) -> None:
    """A file by the name that pages use; any serial arm will do."""
    shutil.copy(UR5E if UR5E.is_file() else DESK_ARM, folder / "ur5e.xml")


def a_shaken_arm(folder: Path) -> None:
    """A model file, and the recording that pages diagnose."""
    some_arm(folder)
    loose_arm(folder / "session" / "recording")


PREPARED: dict[str, Callable[[Path], None]] = {
    "README.md": a_shaken_arm,
    "gap_closing.md": corrected_models,
    "instrument.md": a_shaken_arm,
}
"""What has to be there before a page's examples run."""


@pytest.fixture(autouse=True)
def own_catalogue() -> Any:
    """Effects that a page registers are forgotten again."""
    before = dict(CATALOGUE)
    yield
    CATALOGUE.clear()
    CATALOGUE.update(before)


def run(page: Path, folder: Path) -> dict[str, Any]:
    """Run a page's examples in a folder; return the names they leave."""
    names: dict[str, Any] = {"__name__": page.stem}
    exec(compile(python(page), str(page), "exec"), names)
    return names


@pytest.mark.parametrize(
    "page",
    [p for p in PAGES if p.name not in OWN and any(b.language == "python" for b in blocks(p))],
    ids=lambda page: page.name,
)
def test_examples_run(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    PREPARED.get(page.name, lambda folder: None)(tmp_path)
    monkeypatch.chdir(tmp_path)
    run(page, tmp_path)


def test_pages_with_tests_of_their_own_have_them() -> None:
    for page, test in OWN.items():
        assert page in (Path(__file__).parent / test).read_text(encoding="utf-8")


def test_the_tables_of_environments_are_those_of_the_code() -> None:
    from scripts.dev.write_docs import DOCS, environments

    assert (DOCS / "environments.md").read_text(encoding="utf-8") == environments()


def test_code_says_its_language() -> None:
    """What looks like Python is marked as Python, and so is run."""
    for page in PAGES:
        for block in blocks(page):
            looks = re.search(
                r"^(from \S+ import|import \S+$|\w+ = \w+\()", block.text, re.MULTILINE
            )
            assert block.language or not looks, f"{page.name}, line {block.line}"


@pytest.mark.skipif(not UR5E.is_file(), reason=f"needs the UR5e file at {UR5E}")
def test_from_a_model_file_to_a_loose_link(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "ur5e.xml").write_bytes(UR5E.read_bytes())
    monkeypatch.chdir(tmp_path)
    names = run(ROOT / "docs" / "your_arm.md", tmp_path)
    printed = capsys.readouterr().out
    assert "shoulder_pan_joint" in printed
    assert "structural_looseness@link3, along" in printed
    posterior, hidden = names["posterior"], names["hidden"]
    direction = posterior.directions[2]
    true = np.array(hidden.direction) / np.linalg.norm(hidden.direction)
    assert np.degrees(np.arccos(min(1.0, abs(float(direction @ true))))) < 10.0


def test_the_loop_around_a_robot_settles_and_so_does_its_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    names = run(ROOT / "docs" / "real_arm.md", tmp_path)
    ended, again, runs = names["ended"], names["again"], names["runs"]
    assert ended.named and ended.diagnosis.fault.where == "forearm"
    assert again.named and again.measurements == len(runs) >= 2
    assert again.diagnosis.fault == names["found"].fault
    assert again.diagnosis.fault.where == "forearm"


def test_getting_started_finds_the_fault(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    names = run(ROOT / "docs" / "getting_started.md", tmp_path)
    assert names["info"]["is_success"] and float(names["probabilities"].max()) > 0.9
    assert "structural_looseness@link2 was right" in capsys.readouterr().out


def test_the_examples_of_the_gap_page_find_the_friction(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    a_gap_recording(tmp_path, monkeypatch)
    monkeypatch.chdir(tmp_path)
    shown = [b.text for b in blocks(ROOT / "docs" / "gap.md") if b.language == "python"]
    kinds = ROOT.joinpath("docs", "gap.md").read_text(encoding="utf-8")
    few = re.search(r"`GapSettings\(kinds=(\(.*?\))\)`", kinds)
    assert few is not None
    assert "coulomb_friction" in GapSettings(kinds=eval(few[1])).kinds
    # The whole catalogue takes a while; the page says how to ask for a part of it.
    part = 'tolerance=0.03, kinds=("coulomb_friction",), threads=1'
    code = shown[0].replace("tolerance=0.03", part)
    exec(compile(code, "gap.md", "exec"), {"__name__": "gap"})
    assert re.search(r"^coulomb_friction joint2 ", capsys.readouterr().out, re.MULTILINE)


def test_the_effect_of_the_gap_page_is_one_and_acts() -> None:
    text = (ROOT / "docs" / "gap.md").read_text(encoding="utf-8")
    code = next(b.text for b in blocks(ROOT / "docs" / "gap.md") if "@register" in b.text)
    assert code.splitlines()[0] in text
    exec(compile(code, "gap.md", "exec"), {"__name__": "gap"})
    machine = NominalModel(mujoco.MjSpec.from_string(PLANAR))
    effect = CATALOGUE["balancer"](machine, "link2")
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
