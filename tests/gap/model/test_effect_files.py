"""Effects of one's own, read from files and from cells that are run again."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from loose_env.cli import gap
from loose_env.cli.main import main
from loose_env.errors import InvalidSetting
from loose_env.gap.model.effects.catalogue import CATALOGUE, read_effects
from loose_env.gap.output.result import read_result
from tests.gap.cases.sprung_arm import sprung

CREEP = """
from loose_env.gap.model.effects.catalogue import register
from loose_env.gap.model.effects.sensors import SensorBias

@register
class Creep(SensorBias):
    kind = "creep"
    version = {version}
"""


@pytest.fixture(autouse=True)
def own_catalogue() -> Iterator[None]:
    before = dict(CATALOGUE)
    yield
    CATALOGUE.clear()
    CATALOGUE.update(before)


def test_a_file_registers_effects_and_may_be_run_again(tmp_path: Path) -> None:
    file = tmp_path / "creep.py"
    for version in (1, 2):
        file.write_text(CREEP.format(version=version))
        assert read_effects(file) == ("creep",)
        assert vars(CATALOGUE["creep"])["version"] == version


def test_a_file_without_effects_or_with_a_mistake_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidSetting, match=r"none\.py is no Python file"):
        read_effects(tmp_path / "none.py")
    file = tmp_path / "empty.py"
    file.write_text("x = 1\n")
    with pytest.raises(InvalidSetting, match=r"empty\.py registers no effect"):
        read_effects(file)
    file.write_text("x = 1 / 0\n")
    with pytest.raises(InvalidSetting, match=r"cannot be run: ZeroDivisionError"):
        read_effects(file)


def test_the_command_considers_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording = sprung(tmp_path / "arm", seconds=1.2)
    file = tmp_path / "creep.py"
    file.write_text(CREEP.format(version=1))
    words = ["gap", str(recording.folder), "--out", str(tmp_path / "out"), "--threads", "1"]
    words += ["--kinds", "creep", "--quiet"]
    assert main(words) == 1
    assert "creep" in capsys.readouterr().err
    assert main([*words, "--effects", str(file)]) == 0
    found = read_result(tmp_path / "out")
    assert {tried.kind for tried in found.ranking} == {"creep"}
    assert main([*words, "--effects", str(tmp_path / "none.py")]) == 1
    assert "none.py is no Python file" in capsys.readouterr().err


def test_another_version_of_the_file_starts_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = sprung(tmp_path / "arm", seconds=1.2)
    file = tmp_path / "creep.py"
    keys = []

    def seen(*_: object, stages: object, **__: object) -> None:
        keys.append(stages.key)  # type: ignore[attr-defined]
        raise InvalidSetting("enough")

    monkeypatch.setattr(gap, "find_gap", seen)
    words = ["gap", str(recording.folder), "--out", str(tmp_path / "out"), "--effects", str(file)]
    for version in (1, 1, 2):
        file.write_text(CREEP.format(version=version))
        assert main(words) == 1
    assert keys[0] == keys[1] != keys[2]
