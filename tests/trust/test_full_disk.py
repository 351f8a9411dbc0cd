"""A full disk and a folder that cannot be written to give one clear line, and no half file."""

from __future__ import annotations

import os
import runpy
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

pytest.importorskip("sb3_contrib")
pytest.importorskip("safetensors")
pytest.importorskip("yaml")
pytest.importorskip("jinja2")
pytest.importorskip("matplotlib")

from loose_env.cli.main import main as loose
from scripts.suites.golden import (
    DIAGNOSES,
    GAPS,
    write_gap_recording,
    write_shaken_recording,
)

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]
ROOM = 96
"""Size of the small disk [kB]; the model of a training and a page of results do not fit."""
MAPPING = """
format = "loose-mapping/1"
model = "recording/model.xml"
[sources.t]
kind = "csv"
time = { column = "time", unit = "s" }
[columns]
"sensor.q1" = { source = "t", channel = "sensor.q1" }
"ctrl.m1" = { source = "t", channel = "ctrl.m1" }
[[runs]]
file = "run-0"
"""
TINY = ["--env", "loose_env/Planar-v0"]


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("disk") / "recording"
    write_gap_recording(folder, **GAPS["forward, damping"])
    write_shaken_recording(shaken_beside(folder), **DIAGNOSES["healthy, flat"])
    mapping_beside(folder).write_text(MAPPING)
    return folder


def shaken_beside(recording: Path) -> Path:
    """The recording to diagnose, beside the one to compare with its model."""
    return recording.with_name("shaken")


def mapping_beside(recording: Path) -> Path:
    """The mapping that imports a table of the recording."""
    return recording.with_name("mapping.toml")


def script(name: str, *words: str) -> Callable[[], None]:
    """A script of the repository, run in this process."""

    def run() -> None:
        before, path = sys.argv, list(sys.path)
        sys.argv = [name, *words]
        try:
            runpy.run_path(str(ROOT / "scripts" / f"{name}.py"), run_name="__main__")
        finally:
            sys.argv, sys.path[:] = before, path

    run.script, run.words = name, words  # type: ignore[attr-defined]
    return run


def commands(out: Path, recording: Path) -> dict[str, Callable[[], None]]:
    """Every command that writes, as short as it can be."""
    two = ["--arguments", '{"n_links": 2}']
    agents = ["--agents", "posterior/random", "--episodes", "160", "--workers", "1"]
    short = ["--shard", "1"]
    training = [
        *("--env-kwargs", "n_links:2", "durations:[0.2]", "threads:1", "-n", "8", "-params"),
        *("n_envs:2", "n_steps:4", "batch_size:8", "n_epochs:1", "policy_kwargs:dict()"),
    ]
    pose_sets = ["--quick", "--cases", "1", "--level", "directions", "--arm", "planar2"]

    def tool(*words: str) -> Callable[[], None]:
        def run() -> None:
            if code := loose([*words, "--out", str(out)]):
                sys.exit(code)

        return run

    shaken = shaken_beside(recording)
    gap = ["gap", str(recording), "--kinds", "viscous_friction", "--threads", "1", "--quiet"]
    diagnose = ["diagnose", str(shaken), "--poses", "2", "--quiet"]
    plan = ["plan", str(shaken / "model.xml"), "--poses", "4"]
    table = f"t={recording / 'run-0.csv'}"
    imports = ["import", table, "--mapping", str(mapping_beside(recording)), "--quiet"]

    return {
        "train": script("agents/train", *TINY, "-f", str(out), "--eval-freq", "-1", *training),
        "compare": script("agents/compare", *TINY, *two, *agents, *short, "--out", str(out)),
        "run": script("run_demo", *TINY, *two, *agents, *short, "--out", str(out)),
        "reproduce_thesis": script(
            "reproduce_thesis", "--only", "index_tables", "--workers", "1", "--out", str(out)
        ),
        "pose_sets": script("studies/pose_sets", *pose_sets, "--workers", "1", "--out", str(out)),
        "example_recording": script("example_recording", "--out", str(out / "example")),
        "gap": tool(*gap),
        "diagnose": tool(*diagnose),
        "plan": tool(*plan),
        "import": tool(*imports),
    }


NAMES = list(commands(Path("out"), Path("recording")))
SAID = {"run": "compare"} | {
    name: f"loose {name}" for name in ("gap", "diagnose", "plan", "import")
}


def refused(
    name: str, run: Callable[[], None], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """It ends with one line that begins with the command and says what is wrong."""
    with pytest.raises(SystemExit) as ended:
        run()
    said = capsys.readouterr()
    message = str(ended.value.code)
    if ended.value.code == 1:  # said on the error stream by the command itself
        message = said.err.strip().splitlines()[-1]
    assert message.startswith(f"{SAID.get(name, name)}: "), message
    assert words in message and "\n" not in message and "Traceback" not in said.err, message


@contextmanager
def disk(place: Path, options: str) -> Iterator[None]:
    """A disk of its own at a folder; only root can have one."""
    mount = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(place)]
    if os.geteuid() or subprocess.run(mount, capture_output=True).returncode:
        pytest.skip("no disk can be mounted here; it takes root")
    try:
        yield
    finally:
        subprocess.run(["umount", "-l", str(place)], check=True)


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk with little room; as root a disk of its own."""
    place = tmp_path / "disk"
    place.mkdir()
    with disk(place, f"size={ROOM}k"):
        place.joinpath("filled").write_bytes(bytes((ROOM - 8) * 1024))
        yield place


@pytest.mark.parametrize("name", NAMES)
def test_a_full_disk_is_said_in_one_line(
    small_disk: Path, recording: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    run = commands(small_disk / "out", recording)[name]
    refused(name, run, "the disk is full", capsys)
    # What has its final name is whole: nothing half-written lies there.
    for file in small_disk.joinpath("out").rglob("*"):
        if file.is_file() and file.suffix in (".json", ".parquet", ".zip", ".html", ".xml"):
            assert file.stat().st_size > 0, file


SHORT_FILES = """
import resource, runpy, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (2048, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))
sys.argv = sys.argv[1:]
runpy.run_path(sys.argv[0], run_name="__main__")
"""
"""Runs a script that can make no file longer than a few kilobytes, as on a full disk, for anybody.
In a process of its own: the limit would hold for what the tests themselves write, too."""


@pytest.mark.parametrize("name", ["train", "compare", "example_recording"])
def test_a_file_that_cannot_grow_is_said_in_one_line(tmp_path: Path, name: str) -> None:
    run = commands(tmp_path / "out", tmp_path)[name]
    words = run.words  # type: ignore[attr-defined]
    program = str(ROOT / "scripts" / f"{run.script}.py")  # type: ignore[attr-defined]
    ended = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", SHORT_FILES, program, *words],
        capture_output=True, text=True, env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert ended.returncode == 1
    message = ended.stderr.strip().splitlines()[-1]
    assert message.startswith(f"{name}: ") and "the disk is full" in message, ended.stderr
    assert "Traceback" not in ended.stderr


@pytest.mark.parametrize("name", NAMES)
def test_an_output_folder_below_a_file_is_refused_in_one_line(
    tmp_path: Path, recording: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    tmp_path.joinpath("file").write_text("mine")
    run = commands(tmp_path / "file" / "out", recording)[name]
    refused(name, run, "a file lies where a folder is needed", capsys)
    assert tmp_path.joinpath("file").read_text() == "mine"


@pytest.fixture
def closed(tmp_path: Path) -> Iterator[Path]:
    """A folder that cannot be written to, not by root either."""
    place = tmp_path / "closed"
    place.mkdir()
    if os.geteuid():
        place.chmod(0o500)
        yield place
        place.chmod(0o700)
        return
    with disk(place, "ro,size=64k"):
        yield place


@pytest.mark.parametrize("name", NAMES)
def test_a_folder_without_the_right_to_write_is_said_in_one_line(
    closed: Path, recording: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    run = commands(closed / "out", recording)[name]
    refused(name, run, "no permission", capsys)
    assert list(closed.iterdir()) == []
