"""Datasets that are incomplete, damaged or unknown end with one line that says what to do."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from loose_env.cli.main import main
from tests.importing.formats.arm_log import (
    Motion,
    write_bag,
    write_lerobot,
    write_robomimic,
    write_rtde,
    write_sysid,
)

COLUMN = {
    "lerobot": '{ channel = "observation.state[elbow.pos]", unit = "deg" }',
    "bag": '{ topic = "/joint_states", channel = "position[elbow]" }',
    "demos.hdf5": '{ channel = "obs/robot0_joint_pos[2]" }',
    "sensors.npz": '{ channel = "elbow_pos" }',
}


def refused(home: Path, file: Path, capsys: pytest.CaptureFixture[str], column: str = "",
            source: str = "", run: str = "") -> str:  # fmt: skip
    """The line that the command ends with, after making sure that nothing was written."""
    column = column or COLUMN[file.name]
    text = f'format = "loose-mapping/1"\nmodel = "arm.xml"\n[sources.s]\n{source}\n[columns]\n'
    (home / "map.toml").write_text(f'{text}"sensor.elbow_pos" = {column}\n[[runs]]\n{run}\n')
    told = ["import", str(file), "--mapping", str(home / "map.toml"), "--out", str(home / "out")]
    assert main([*told, "--quiet"]) == 1
    assert not (home / "out").exists()
    said = capsys.readouterr().err.strip()
    assert "\n" not in said
    assert "Traceback" not in said
    return said


def info(folder: Path, **changes: object) -> None:
    path = folder / "meta/info.json"
    whole = json.loads(path.read_text())
    path.write_text(json.dumps({**whole, **changes}))


def no_rows_of_episode(folder: Path) -> None:
    path = folder / "data/chunk-000/file-000.parquet"
    table = pq.read_table(path)
    pq.write_table(table.filter(pa.compute.equal(table["episode_index"], 1)), path)


def drop(folder: Path, column: str) -> None:
    path = folder / "data/chunk-000/file-000.parquet"
    pq.write_table(pq.read_table(path).drop_columns([column]), path)


def cut(path: Path, share: float = 0.5) -> None:
    whole = path.read_bytes()
    path.write_bytes(whole[: int(len(whole) * share)])


LEROBOT: dict[str, tuple[Callable[[Path], object], str]] = {
    "no info": (lambda f: (f / "meta/info.json").unlink(), "meta/info.json"),
    "info is no JSON": (lambda f: cut(f / "meta/info.json"), "not JSON"),
    "unknown version": (lambda f: info(f, codebase_version="v9.0"), "read are v2.0, v2.1, v3.0"),
    "no features": (lambda f: info(f, features={}), "features is missing"),
    "path outside": (lambda f: info(f, data_path="../x.parquet"), "no path within the folder"),
    "unknown field": (lambda f: info(f, data_path="{x:03d}.parquet"), "data_path names 'x'"),
    "no episodes": (lambda f: shutil.rmtree(f / "meta/episodes"), "no Parquet files"),
    "no data": (lambda f: shutil.rmtree(f / "data"), "there is no file"),
    "truncated": (lambda f: cut(f / "data/chunk-000/file-000.parquet"), "cut short or damaged"),
    "empty episode": (no_rows_of_episode, "episode_000000: it has 0 frames"),
    "no times": (lambda f: drop(f, "timestamp"), "there is no column 'timestamp'"),
    "no states": (lambda f: drop(f, "observation.state"), "no column 'observation.state'"),
}


@pytest.mark.parametrize("kind", list(LEROBOT))
def test_lerobot_datasets_that_are_incomplete(
    home: Path, motion: Motion, kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_lerobot(home / "lerobot", motion)
    spoil, words = LEROBOT[kind]
    spoil(folder)
    assert words in refused(home, folder, capsys)


@pytest.mark.parametrize(
    ("column", "run", "words"),
    [
        ('{ channel = "observation.state[elbow.pos]" }', "", "unit = 'deg', unit = 'rad', or"),
        ('{ channel = "observation.state[elbow.pos]", unit = "V" }', "", "measures voltage"),
        ('{ channel = "observation.state[elbo.pos]", unit = "deg" }', "", "did you mean"),
        ('{ channel = "observation.state[7]", unit = "deg" }', "", "[0] to [2]"),
        ('{ channel = "observation.stat[0]", unit = "deg" }', "", "did you mean"),
        ('{ channel = "observation.images.top", unit = "deg" }', "", "no feature"),
        ('{ channel = "a[b][c]", unit = "deg" }', "", "is no channel"),
        ('{ topic = "t", channel = "action[0]", unit = "deg" }', "", "has no topics"),
        ("", 'episodes = "7"', "there is no episode 7"),
        ("", 'episodes = "first"', "is no episode"),
        ("", 'episodes = ","', "chooses no episode"),
    ],
)
def test_columns_and_episodes_that_a_dataset_lacks(
    home: Path, motion: Motion, column: str, run: str, words: str,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    folder = write_lerobot(home / "lerobot", motion)
    assert words in refused(home, folder, capsys, column, run=run)


def metadata(folder: Path, old: str, new: str) -> None:
    path = folder / "metadata.yaml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def files_of(folder: Path) -> Path:
    return next(each for each in folder.iterdir() if each.name != "metadata.yaml")


BAG: dict[str, tuple[Callable[[Path], object], str]] = {
    "no metadata": (lambda f: (f / "metadata.yaml").unlink(), "ros2 bag reindex"),
    "no YAML": (lambda f: (f / "metadata.yaml").write_text("a: [\n"), "not YAML"),
    "no bag": (lambda f: (f / "metadata.yaml").write_text("a: 1\n"), "is it a ROS 2 bag"),
    "unknown version": (lambda f: metadata(f, "version: 9", "version: 99"), "read are 1 to 9"),
    "unknown storage": (
        lambda f: metadata(f, "storage_identifier: sqlite3", "storage_identifier: tape"),
        "read are mcap and sqlite3",
    ),
    "no file": (lambda f: files_of(f).unlink(), "there is no file"),
    "truncated": (lambda f: cut(files_of(f)), "cannot be read as a ROS 2 bag in SQLite"),
    "no database": (lambda f: files_of(f).write_bytes(b"x" * 4096), "cannot be read as a ROS 2"),
}


@pytest.mark.parametrize("kind", list(BAG))
def test_bags_that_are_incomplete(
    home: Path, motion: Motion, kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_bag(home / "bag", motion)
    spoil, words = BAG[kind]
    spoil(folder)
    assert words in refused(home, folder, capsys)


def linked(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        del file["data/demo_0/obs/robot0_joint_pos"]
        file["data/demo_0/obs/robot0_joint_pos"] = h5py.ExternalLink("other.hdf5", "/x")


def shortened(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        for key in ("data/demo_0/obs/robot0_joint_pos",):
            del file[key]
            file[key] = np.zeros((0, 3))


def without_data(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        del file["data"]


HDF5: dict[str, tuple[Callable[[Path], object], str]] = {
    "truncated": (cut, "cut short or damaged"),
    "no data": (without_data, "no group 'data'"),
    "link to another file": (linked, "there is no dataset"),
    "empty demonstration": (shortened, "it has 0 samples"),
}


@pytest.mark.parametrize("kind", list(HDF5))
def test_demonstrations_that_are_incomplete(
    home: Path, motion: Motion, kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_robomimic(home / "demos.hdf5", motion)
    spoil, words = HDF5[kind]
    spoil(path)
    assert words in refused(home, path, capsys, source="time = { rate_hz = 125 }")


def test_demonstrations_need_a_rate(
    home: Path, motion: Motion, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_robomimic(home / "demos.hdf5", motion)
    assert "give the rate of control" in refused(home, path, capsys)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.97])
def test_time_series_that_are_cut(
    home: Path, motion: Motion, share: float, capsys: pytest.CaptureFixture[str]
) -> None:
    path, _ = write_sysid(home, motion)
    cut(path, share)
    assert "cut short or damaged" in refused(home, path, capsys)


def test_archives_of_other_arrays_and_objects(
    home: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = home / "sensors.npz"
    np.savez(path, a=np.zeros(3))
    assert "neither a TimeSeries" in refused(home, path, capsys)
    np.savez(path, times=np.arange(3.0), data=np.array([{}, {}, {}], dtype=object))
    assert "holds objects" in refused(home, path, capsys)
    np.savez(path, times=np.arange(3.0), data=np.zeros((2, 1)))
    assert "one row for each time" in refused(home, path, capsys)


def test_names_of_a_table_that_are_too_few(
    home: Path, motion: Motion, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_rtde(home / "log.csv", motion, header=False)
    source = 'separator = " "\nheader = false\nnames = ["timestamp", "actual_q"]\n'
    source += 'time = { column = "timestamp" }'
    said = refused(home, path, capsys, '{ channel = "actual_q_2" }', source)
    assert "13 cells, and names of the source gives 7 columns" in said
