"""Each format, written by its own writer, is guessed, imported, and holds the known motion."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from loose_env.cli.main import main
from loose_env.importing import describe_sources
from loose_env.recording import Recording, read_recording
from tests.importing.formats.arm_log import (
    JOINTS,
    Motion,
    write_bag,
    write_lerobot,
    write_robomimic,
    write_rtde,
    write_sysid,
)

ALL = {f"sensor.{n}_pos" for n in JOINTS} | {"ctrl.pan", "ctrl.lift", "ctrl.bend"}
RATES = {f"sensor.{n}_vel" for n in JOINTS}


def guessed(home: Path, files: Sequence[Path], *options: str) -> dict:
    """Columns of the mapping that --guess writes."""
    told = ["import", "--guess", *map(str, files), "--model", str(home / "arm.xml")]
    assert main([*told, "--mapping", str(home / "map.toml"), *options]) == 0
    return tomllib.loads((home / "map.toml").read_text())["columns"]


def imported(home: Path, files: Sequence[Path]) -> Recording:
    told = ["import", *map(str, files), "--mapping", str(home / "map.toml")]
    assert main([*told, "--out", str(home / "out")]) == 0
    return read_recording(home / "out")


def check(recording: Recording, motion: Motion, *, digits: float = 1e-6) -> None:
    """The known motion, in SI units, under the model's names."""
    for run in recording.runs:
        assert len(run.time) == len(motion.time)
        for i, (joint, command) in enumerate(zip(JOINTS, ("pan", "lift", "bend"), strict=True)):
            np.testing.assert_allclose(
                run.sensors[f"{joint}_pos"], motion.position[:, i], atol=digits
            )
            np.testing.assert_allclose(run.controls[command], motion.command[:, i], atol=digits)


WRITERS: dict[str, Callable[[Path, Motion], list[Path]]] = {
    "rtde": lambda home, m: [write_rtde(home / "log.csv", m)],
    "rtde without header": lambda home, m: [write_rtde(home / "log.csv", m, header=False)],
    "rtde with commas": lambda home, m: [
        write_rtde(home / "log.csv", m, header=False, separator=",")
    ],
    "rosbag2 sqlite3": lambda home, m: [write_bag(home / "bag", m)],
    "rosbag2 sqlite3 packed": lambda home, m: [write_bag(home / "bag", m, packed=True)],
    "rosbag2 before Iron": lambda home, m: [write_bag(home / "bag", m, definitions=False)],
    "rosbag2 mcap": lambda home, m: [write_bag(home / "bag", m, storage="mcap")],
    "robomimic": lambda home, m: [write_robomimic(home / "demos.hdf5", m)],
    "sysid": lambda home, m: list(write_sysid(home, m)),
}


@pytest.mark.parametrize("kind", list(WRITERS))
def test_a_guessed_mapping_imports_the_known_motion(home: Path, motion: Motion, kind: str) -> None:
    files = WRITERS[kind](home, motion)
    columns = guessed(home, files)
    assert set(columns) - {f"torque.{n}" for n in JOINTS} == ALL | RATES
    check(imported(home, files), motion)


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_episodes_of_lerobot_become_runs(home: Path, motion: Motion, version: str) -> None:
    files = [write_lerobot(home / "set", motion, version=version)]
    columns = guessed(home, files)
    assert set(columns) == ALL
    assert {each["unit"] for each in columns.values()} == {"deg"}
    recording = imported(home, files)
    assert [Path(run.name).stem for run in recording.runs] == [
        "set-episode_000000",
        "set-episode_000001",
    ]
    check(recording, motion, digits=1e-5)  # float32 degrees


def test_chosen_episodes_alone_are_imported(home: Path, motion: Motion) -> None:
    files = [write_lerobot(home / "set", motion, episodes=4)]
    guessed(home, files)
    text = (home / "map.toml").read_text()
    (home / "map.toml").write_text(text.replace('episodes = "all"', 'episodes = "1, 3"'))
    names = [Path(run.name).stem for run in imported(home, files).runs]
    assert names == ["set-episode_000001", "set-episode_000003"]


def test_a_single_db3_file_needs_no_metadata(home: Path, motion: Motion) -> None:
    bag = write_bag(home / "bag", motion)
    files = list(bag.glob("*.db3"))
    guessed(home, files)
    check(imported(home, files), motion)


@pytest.mark.parametrize("kind", list(WRITERS))
def test_channels_are_described_for_the_model(home: Path, motion: Motion, kind: str) -> None:
    text = describe_sources([str(file) for file in WRITERS[kind](home, motion)])
    tomllib.loads(text)
    assert "sensor.?" in text
