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
from scripts.example_recording import loose_arm
from scripts.suites.golden import GAPS, write_gap_recording

pytestmark = pytest.mark.slow

Capture = pytest.CaptureFixture[str]
ROOT = Path(__file__).resolve().parents[2]
ROOM = 96
"""Size of the small disk [kB]; the model of a training and a page of results do not fit."""
MAPPING = """
format = "loose-mapping/1"
model = "recording/model.xml"
[sources.t]
time = { column = "time", unit = "s" }
[columns]
"sensor.q1" = { source = "t", channel = "sensor.q1" }
"ctrl.m1" = { source = "t", channel = "ctrl.m1" }
[[runs]]
file = "run-0"
"""
TINY = ["--env", "loose_env/Planar-v0"]
TRAINING = [
    *("--env-kwargs", "n_links:2", "durations:[0.2]", "threads:1", "-n", "8", "-params"),
    *("n_envs:2", "n_steps:4", "batch_size:8", "n_epochs:1", "policy_kwargs:dict()"),
]
AGENTS = [
    *("--arguments", '{"n_links": 2}', "--agents", "posterior/random", "--episodes", "160"),
    *("--workers", "1", "--shard", "1"),
]
SCRIPTS: dict[str, tuple[str, Callable[[Path], list[str]]]] = {
    "train": (
        "agents/train", lambda out: [*TINY, "-f", str(out), "--eval-freq", "-1", *TRAINING]),
    "compare": ("agents/compare", lambda out: [*TINY, *AGENTS, "--out", str(out)]),
    "example_recording": ("example_recording", lambda out: ["--out", str(out / "example")]),
}  # fmt: skip
"""Scripts that write, as short as they can be: their file and their words."""
COMMANDS: dict[str, Callable[[Path], list[str]]] = {
    "gap": lambda home: [str(home / "recording"), "--kinds", "viscous_friction", "--threads", "1"],
    "diagnose": lambda home: [str(home / "session" / "recording"), ],
    "plan": lambda home: [str(home / "session" / "recording" / "model.xml")],
    "import": lambda home: [
        f"t={home / 'recording' / 'run-0.csv'}", "--mapping", str(home / "mapping.toml")],
}  # fmt: skip
NAMES = [*SCRIPTS, *COMMANDS]


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a recording, one to diagnose, and a mapping that imports a table."""
    folder = tmp_path_factory.mktemp("disk")
    write_gap_recording(folder / "recording", **GAPS["forward, damping"])
    loose_arm(folder / "session" / "recording")
    (folder / "mapping.toml").write_text(MAPPING)
    return folder


def refused(name: str, out: Path, home: Path, words: str, capsys: Capture) -> None:
    """It ends with one line that begins with the command and says what is wrong."""
    if name in COMMANDS:
        assert loose([name, *COMMANDS[name](home), "--out", str(out)]) == 1
        message = capsys.readouterr().err.strip().splitlines()[-1]
        assert message.startswith(f"loose {name}: ")
    else:
        script, given = SCRIPTS[name]
        before, path = sys.argv, list(sys.path)
        sys.argv = [script, *given(out)]
        try:
            with pytest.raises(SystemExit) as ended:
                runpy.run_path(str(ROOT / "scripts" / f"{script}.py"), run_name="__main__")
        finally:
            sys.argv, sys.path[:] = before, path
        message = str(ended.value.code)
        assert message.startswith(f"{name}: ") and "Traceback" not in capsys.readouterr().err
    assert words in message and "\n" not in message, message


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


@pytest.mark.parametrize("name", NAMES)
def test_a_full_disk_is_said_in_one_line(
    tmp_path: Path, home: Path, name: str, capsys: Capture
) -> None:
    with disk(tmp_path, f"size={ROOM}k"):
        tmp_path.joinpath("filled").write_bytes(bytes((ROOM - 8) * 1024))
        refused(name, tmp_path / "out", home, "the disk is full", capsys)
        # What has its final name is whole: nothing half-written lies there.
        for file in tmp_path.joinpath("out").rglob("*"):
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


@pytest.mark.parametrize("name", SCRIPTS)
def test_a_file_that_cannot_grow_is_said_in_one_line(tmp_path: Path, name: str) -> None:
    script, given = SCRIPTS[name]
    program = [str(ROOT / "scripts" / f"{script}.py"), *given(tmp_path / "out")]
    ended = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", SHORT_FILES, *program],
        capture_output=True, text=True, env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert ended.returncode == 1
    message = ended.stderr.strip().splitlines()[-1]
    assert message.startswith(f"{name}: ") and "the disk is full" in message, ended.stderr
    assert "Traceback" not in ended.stderr


@pytest.mark.parametrize("name", NAMES)
def test_an_output_folder_below_a_file_is_refused_in_one_line(
    tmp_path: Path, home: Path, name: str, capsys: Capture
) -> None:
    tmp_path.joinpath("file").write_text("mine")
    refused(name, tmp_path / "file" / "out", home, "a file lies where a folder is needed", capsys)
    assert tmp_path.joinpath("file").read_text() == "mine"


@pytest.mark.parametrize("name", NAMES)
def test_a_folder_without_the_right_to_write_is_said_in_one_line(
    tmp_path: Path, home: Path, name: str, capsys: Capture
) -> None:
    if os.geteuid():
        tmp_path.chmod(0o500)
        refused(name, tmp_path / "out", home, "no permission", capsys)
        tmp_path.chmod(0o700)
    else:
        with disk(tmp_path, "ro,size=64k"):
            refused(name, tmp_path / "out", home, "no permission", capsys)
            assert list(tmp_path.iterdir()) == []
