"""The command `loose export`: what it writes, lists and refuses."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from loose_env.cli.main import main
from tests.gap.cases.exported_result import write_result


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_result(tmp_path / "gap")
    return tmp_path / "gap"


def test_files_are_written_and_what_is_lost_is_listed(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert main(["export", str(folder), "--to", "urdf", "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert f"written: {out / 'dynamics.urdf.xml'}" in said
    assert "not expressed by urdf:\n" in said and "backlash at wrist" in said
    assert main(["export", str(folder / "result.json"), "--to", "ranges", "--out", str(out)]) == 0
    names = sorted(path.name for path in out.iterdir())
    assert names == [".gap", "dynamics.urdf.xml", "ranges.json"]


def test_the_json_document_names_files_and_what_is_lost(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["export", str(folder), "--to", "mjlab", "--out", str(tmp_path / "out")]
    assert main([*command, "--json", "-", "--quiet"]) == 0
    whole = json.loads(capsys.readouterr().out)
    assert whole["format"] == "loose-export/1" and whole["target"] == "mjlab"
    assert whole["files"] == [str(tmp_path / "out" / "mjlab_actuators.py")]
    assert any("sensor_gain at encoder2" in words for words in whole["not_expressed"])


def test_mistakes_end_in_one_line_and_write_nothing(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    taken = tmp_path / "taken"
    taken.mkdir()
    taken.joinpath("ranges.json").write_text("mine")
    arm = tmp_path / "arm.urdf"
    arm.write_text("<robot name='arm'/>")
    out = tmp_path / "out"
    for words, reason in (
        ([str(tmp_path / "none"), "--to", "ranges", "--out", str(out)], "none"),
        ([str(folder), "--to", "ranges", "--out", str(taken)], "holds other files"),
        ([str(folder), "--to", "ranges", "--out", str(folder)], "holds other files"),
        ([str(folder), "--to", "bam", "--out", str(out)], "give --servo with one of"),
        ([str(folder), "--to", "mjlab", "--timestep", "0", "--out", str(out)], "timestep"),
        ([str(folder), "--to", "mjlab", "--urdf", str(arm), "--out", str(out)], "--to urdf"),
        ([str(folder), "--to", "urdf", "--urdf", str(arm), "--out", str(out)], "has no joint"),
        ([str(folder), "--to", "urdf", "--urdf", str(out), "--out", str(out)], "out"),
        ([str(folder), "--to", "urdf", "--urdf", str(arm), "--out", str(arm)], "is a file"),
    ):
        assert main(["export", *words]) == 1, words
        said = capsys.readouterr().err
        assert said.startswith("loose export: ") and said.count("\n") == 1, said
        assert reason in said, said
    assert not out.exists() and taken.joinpath("ranges.json").read_text() == "mine"


def test_an_unknown_target_is_answered_with_those_there_are(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["export", str(folder), "--to", "gazebo", "--out", str(tmp_path / "out")])
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert "gazebo" in said and "isaaclab" in said
