"""What is written reads back as it was, and nothing else is ever left on the disk."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from loose_env.errors import InvalidData, InvalidSetting, UnknownName
from loose_env.recording import Run, read_recording, write_recording, writing
from tests.recording.conftest import ARM, TIME

Swing = Callable[..., Run]


def tetrahedron() -> bytes:
    """A binary STL of a tetrahedron."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype="<f4")
    raw = bytes(80) + np.uint32(4).tobytes()
    for face in ([0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]):
        raw += bytes(12) + corners[face].tobytes() + bytes(2)
    return raw


def assert_same(run: Run, other: Run) -> None:
    np.testing.assert_array_equal(run.time, other.time)
    for group in ("controls", "sensors", "torques"):
        mine, theirs = getattr(run, group), getattr(other, group)
        assert mine.keys() == theirs.keys()
        for name, values in mine.items():
            assert values.shape == theirs[name].shape
            np.testing.assert_array_equal(np.isnan(values), np.isnan(theirs[name]))
            known = ~np.isnan(values)
            # By bits: a negative zero is not a zero.
            assert values[known].tobytes() == theirs[name][known].tobytes()
    assert (run.excited, run.pose, run.condition) == (other.excited, other.pose, other.condition)


@pytest.mark.parametrize("file_format", ["parquet", "csv"])
@pytest.mark.parametrize("seed", range(2))
def test_every_number_comes_back(
    tmp_path: Path, swing: Swing, file_format: writing.FileFormat, seed: int
) -> None:
    runs = [
        swing("one.parquet", seed=seed, samples=10 + 7 * seed, pose={"reach": 0.1 + 0.2}),
        swing("two.csv", seed=seed + 9, excited=("shoulder", "reach"), condition="healthy"),
        swing("day.1/three", seed=seed + 5, controls={}, torques={}),
    ]
    written = write_recording(
        tmp_path / "new" / "made", model_xml=ARM, runs=runs, file_format=file_format
    )
    read = read_recording(tmp_path / "new" / "made")
    names = [f"{stem}.{file_format}" for stem in ("one", "two", "day.1/three")]
    assert [run.name for run in read.runs] == names
    for given, returned, found in zip(runs, written.runs, read.runs, strict=True):
        assert_same(given, returned)
        assert_same(given, found)
    assert written.folder == read.folder and written.model_path == read.model_path
    assert written.model().nv == 3
    assert [p.name for p in tmp_path.joinpath("new").iterdir()] == ["made"]


def test_a_model_file_brings_what_it_refers_to(tmp_path: Path, swing: Swing) -> None:
    source = tmp_path / "cad"
    source.joinpath("meshes").mkdir(parents=True)
    source.joinpath("parts").mkdir()
    text = ARM.replace(
        "<worldbody>",
        '<compiler meshdir="meshes"/><asset><mesh name="m" file="m.stl"/></asset>'
        '<include file="parts/floor.xml"/><worldbody><geom type="mesh" mesh="m"/>',
    )
    source.joinpath("arm.xml").write_text(text)
    source.joinpath("meshes", "m.stl").write_bytes(tetrahedron())
    source.joinpath("parts", "floor.xml").write_text(
        '<mujocoinclude><worldbody><geom name="floor" type="plane" size="1 1 1"/></worldbody>'
        "</mujocoinclude>"
    )
    source.joinpath("notes.txt").write_text("not wanted")
    made = write_recording(tmp_path / "made", model_xml=source / "arm.xml", runs=[swing()])
    source.rename(tmp_path / "gone")
    assert made.model().nmesh == 1
    assert made.spec().geom("floor") is not None
    files = {str(p.relative_to(made.folder)) for p in made.folder.rglob("*") if p.is_file()}
    assert files == {
        "arm.xml",
        "meshes/m.stl",
        "parts/floor.xml",
        "recording.json",
        "swing.parquet",
    }


@pytest.mark.parametrize(
    ("change", "pattern"),
    [
        ({"time": np.zeros(50)}, r"swing\.parquet: column 'time', row 2"),
        ({"controls": {"crane": np.zeros(50)}}, r"column 'ctrl\.crane'"),
        ({"sensors": {"tool": np.zeros(50)}}, r"column 'sensor\.tool'.*3-vector"),
        ({"sensors": {"rate": np.zeros((50, 3))}}, r"column 'sensor\.rate\.x'"),
        ({"sensors": {}, "torques": {}}, r"no column of data"),
        ({"torques": {"reach": np.full(50, np.inf)}}, r"column 'torque\.reach', row 1"),
        ({"pose": {"reach": np.nan}}, r"NaN is no number"),
        ({"excited": ("elbow",)}, r"'elbow' is no hinge"),
        ({"name": "../out.csv"}, r"leaves the folder"),
        ({"name": "/tmp/out.csv"}, r"is absolute"),
        ({"name": "recording.json/x"}, r"recording\.json"),
    ],
)
def test_what_would_not_read_is_not_written(
    tmp_path: Path, swing: Swing, change: dict[str, object], pattern: str
) -> None:
    run = dataclasses.replace(swing(), **change)  # type: ignore[arg-type]
    with pytest.raises(InvalidData, match=pattern):
        write_recording(tmp_path / "made", model_xml=ARM, runs=[run])
    assert list(tmp_path.iterdir()) == []


def test_two_runs_of_one_name_are_refused(tmp_path: Path, swing: Swing) -> None:
    with pytest.raises(InvalidData, match=r"two files 'a\.csv'"):
        runs = [swing("a.csv"), swing("a.parquet")]
        write_recording(tmp_path / "made", model_xml=ARM, runs=runs, file_format="csv")
    with pytest.raises(InvalidData, match=r"runs: .*at least 1"):
        write_recording(tmp_path / "made", model_xml=ARM, runs=[])
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_holds_something_is_kept(tmp_path: Path, swing: Swing) -> None:
    place = tmp_path / "made"
    place.mkdir()
    first = write_recording(place, model_xml=ARM, runs=[swing()])  # empty: taken
    with pytest.raises(InvalidSetting, match=r"not empty; give a new"):
        write_recording(place, model_xml=ARM, runs=[swing(seed=1)])
    assert_same(read_recording(place).runs[0], first.runs[0])
    write_recording(place, model_xml=ARM, runs=[swing("b", seed=1)], overwrite=True)
    assert [run.name for run in read_recording(place).runs] == ["b.parquet"]
    assert not place.joinpath("swing.parquet").exists()
    bad = dataclasses.replace(swing(), time=np.zeros(50))
    with pytest.raises(InvalidData):
        write_recording(place, model_xml=ARM, runs=[bad], overwrite=True)
    assert [run.name for run in read_recording(place).runs] == ["b.parquet"]
    other = tmp_path / "thesis"
    other.mkdir()
    other.joinpath("chapter.tex").write_text("years of work")
    with pytest.raises(InvalidSetting, match="not overwritten"):
        write_recording(other, model_xml=ARM, runs=[swing()], overwrite=True)
    with pytest.raises(InvalidSetting, match="is a file"):
        write_recording(other / "chapter.tex", model_xml=ARM, runs=[swing()], overwrite=True)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["made", "thesis"]


def test_overwriting_deletes_no_file_that_the_recording_does_not_name(
    tmp_path: Path, swing: Swing
) -> None:
    place = tmp_path / "made"
    model = tmp_path / "cad" / "arm.xml"
    model.parent.mkdir()
    model.with_name("m.stl").write_bytes(tetrahedron())
    asset = '<asset><mesh name="m" file="m.stl"/></asset><worldbody>'
    model.write_text(ARM.replace("<worldbody>", asset))
    runs = [swing("day.1/a")]
    write_recording(place, model_xml=model, runs=runs)
    write_recording(place, model_xml=model, runs=runs, overwrite=True)  # its own, mesh and all
    notes = [place / "notes.txt", place / "day.1" / "raw.csv"]
    for each in notes:
        each.write_text("of the user")
    with pytest.raises(InvalidSetting, match=r"day\.1/raw\.csv, notes\.txt, which") as error:
        write_recording(place, model_xml=model, runs=runs, overwrite=True)
    assert "\n" not in str(error.value)
    assert all(each.read_text() == "of the user" for each in notes)
    for each in notes:
        each.unlink()
    place.joinpath("recording.json").write_text("{")
    with pytest.raises(InvalidSetting, match="cannot be told which"):
        write_recording(place, model_xml=model, runs=runs, overwrite=True)
    assert place.joinpath("day.1", "a.parquet").exists()


def test_wrong_arguments_are_named(tmp_path: Path, swing: Swing) -> None:
    with pytest.raises(UnknownName, match=r"parquet.*csv.*hdf5"):
        write_recording(tmp_path / "a", model_xml=ARM, runs=[swing()], file_format="hdf5")  # type: ignore[arg-type]
    with pytest.raises(InvalidSetting, match="there is no model"):
        write_recording(tmp_path / "a", model_xml="none.xml", runs=[swing()])
    with pytest.raises(InvalidData, match=r"column 'sensor\.angle' has shape \(3,\)"):
        Run(name="a.csv", time=TIME, sensors={"angle": np.zeros(3)})
    with pytest.raises(InvalidData, match=r"column 'ctrl\.lift' does not hold numbers"):
        Run(name="a.csv", time=TIME, controls={"lift": ["a"] * 20})  # type: ignore[dict-item]
    with pytest.raises(InvalidData, match="condition is 'new'"):
        Run(name="a.csv", time=TIME, condition="new")  # type: ignore[arg-type]
    assert list(tmp_path.iterdir()) == []
