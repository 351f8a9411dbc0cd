from __future__ import annotations

from pathlib import Path

import pytest

from loose_env.cli.console import OutputFolder
from loose_env.errors import InvalidSetting


def test_a_new_and_an_empty_folder_are_taken(tmp_path: Path) -> None:
    assert OutputFolder(tmp_path / "new", "gap").prepared().is_dir()
    (tmp_path / "empty").mkdir()
    OutputFolder(tmp_path / "empty", "gap")


def test_a_mistake_leaves_no_empty_folder_behind(tmp_path: Path) -> None:
    def mistaken(folder: Path, *, keeps: bool = False) -> None:
        with (
            pytest.raises(InvalidSetting, match="no such effect"),
            OutputFolder(folder, "gap").worked_in() as kept,
        ):
            if keeps:
                kept.joinpath("stage.npz").write_text("an hour of work")
            raise InvalidSetting("no such effect")

    mistaken(tmp_path / "new")
    assert not (tmp_path / "new").exists()
    (tmp_path / "empty").mkdir()
    mistaken(tmp_path / "empty")
    assert list((tmp_path / "empty").iterdir()) == []
    mistaken(tmp_path / "worth", keeps=True)
    assert (tmp_path / "worth" / ".gap" / "stage.npz").exists()
    mistaken(tmp_path / "worth")
    assert (tmp_path / "worth" / ".gap" / "stage.npz").exists()


def test_a_folder_with_other_files_is_refused_and_names_them(tmp_path: Path) -> None:
    tmp_path.joinpath("thesis.tex").write_text("years of work")
    with pytest.raises(InvalidSetting, match=r"thesis\.tex"):
        OutputFolder(tmp_path, "gap")
    assert tmp_path.joinpath("thesis.tex").read_text() == "years of work"


def test_somebody_elses_model_is_not_overwritten(tmp_path: Path) -> None:
    tmp_path.joinpath("model.xml").write_text("<mujoco/>")
    with pytest.raises(InvalidSetting, match=r"model\.xml"):
        OutputFolder(tmp_path, "gap")


def test_the_folder_of_an_earlier_run_is_taken_with_all_it_wrote(tmp_path: Path) -> None:
    first = OutputFolder(tmp_path, "gap")
    first.prepared()
    for name in ("model.xml", "result.json", ".model.12.part.xml"):
        tmp_path.joinpath(name).write_text("")
    mesh = tmp_path / "assets" / "link.obj"
    mesh.parent.mkdir()
    mesh.write_text("")
    with pytest.raises(InvalidSetting, match="assets"):
        OutputFolder(tmp_path, "gap")
    first.note([tmp_path / "model.xml", mesh])
    OutputFolder(tmp_path, "gap")
    tmp_path.joinpath("notes.txt").write_text("mine")
    with pytest.raises(InvalidSetting, match=r"notes\.txt"):
        OutputFolder(tmp_path, "gap")


def test_a_file_is_no_folder(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("")
    with pytest.raises(InvalidSetting, match="is a file"):
        OutputFolder(file, "gap")


@pytest.mark.parametrize(
    ("mine", "other", "format"),
    [("gap", "diagnose", "loose-diagnosis/1"), ("diagnose", "gap", "loose-gap/1")],
)
def test_what_another_command_wrote_is_not_overwritten(
    tmp_path: Path, mine: str, other: str, format: str
) -> None:
    OutputFolder(tmp_path, other).prepared()
    result = tmp_path / "result.json"
    result.write_text(f'{{"format": "{format}"}}')
    said = f"holds what 'loose {other}' wrote, and 'loose {mine}' would overwrite it"
    with pytest.raises(InvalidSetting, match=said):
        OutputFolder(tmp_path, mine)
    OutputFolder(tmp_path, other)
    # A folder of an earlier version, which did not note whose it is.
    (tmp_path / ".gap" / "command").unlink()
    with pytest.raises(InvalidSetting, match=said):
        OutputFolder(tmp_path, mine)
    OutputFolder(tmp_path, other)
    result.unlink()
    OutputFolder(tmp_path, mine)
