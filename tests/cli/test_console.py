"""What all commands share: verbosity, JSON, completion, help, output folder; the preflight."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from loose_env.arms import DESK_ARM
from loose_env.cli.console import OutputFolder
from loose_env.cli.main import COMMANDS, SHELLS, main
from loose_env.errors import InvalidSetting
from loose_env.recording import write_recording
from loose_env.version import __version__
from scripts.dev.write_docs import FORMATS, schema
from tests.doctor.machine import record, with_sensors, xml

INSPECT = ["inspect", str(DESK_ARM), "--poses", "3"]
Capture = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def in_degrees(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording whose joint positions are in another unit, beside the right one."""
    folder = tmp_path_factory.mktemp("doctor")
    turned = with_sensors(record(folder / "right"), "q_", np.degrees)
    write_recording(folder / "degrees", model_xml=xml(), runs=turned.runs)
    return folder / "degrees"


def called(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *words], capture_output=True, text=True, check=False, timeout=120
    )


def refused(capsys: Capture, *words: str) -> str:
    """The one line that a command says which refuses what it was given."""
    assert main(words) == 1
    said = capsys.readouterr()
    assert not said.out and said.err.count("\n") == 1
    return said.err


def read(path: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(path.read_text("utf-8"))
    return found


def test_the_version_is_said_without_loading_what_computes() -> None:
    code = (
        "import sys\nfrom loose_env.cli.main import main\nmain(['--version'])\n"
        "print(sorted({'mujoco', 'pyarrow', 'scipy', 'tyro'} & set(sys.modules)))"
    )
    assert called("-c", code).stdout == f"loose-env {__version__}\n[]\n"
    done = called("-m", "loose_env", "--version")
    assert (done.returncode, done.stdout, done.stderr) == (0, f"loose-env {__version__}\n", "")


def test_help_lists_commands_and_options(capsys: Capture) -> None:
    assert main([]) == 0
    said = capsys.readouterr()
    assert said.out.startswith("usage: loose") and not said.err
    assert all(f"\n  {name} " in said.out for name in COMMANDS)
    assert main(["--help"]) == 0
    assert capsys.readouterr().out == said.out


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_the_options_of_output(name: str, capsys: Capture) -> None:
    with pytest.raises(SystemExit) as ended:
        main([name, "--help"])
    assert ended.value.code == 0
    said = capsys.readouterr().out
    assert all(words in said for words in ("--json FILE", "--quiet", "--verbose", "Exit codes"))
    with pytest.raises(SystemExit) as ended:
        main([name, "--quiet", "--verbose"])
    assert ended.value.code == 2
    assert "--quiet and --verbose exclude each other" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["fly"], "loose: 'fly' is no command; there are inspect, "),
        (["--print-completion", "sh"], "loose: --print-completion takes one of bash, "),
        (["gap", "here"], "loose gap: --out DIR must be given, or --check"),
        (["gap", "--wrong"], "loose gap: RECORDING must be given"),
        (["gap", "a", "--tolerances.mass", "x"], "--tolerances.mass takes FLOAT; got"),
        (["export", "here", "--to", "gazebo", "--out", "o"], "--to must be one of sysid, mjlab, "),
        (["import"], "loose import: SOURCE must be given"),
        (["import", "a"], "give --mapping MAP and --out RECORDING, or --guess"),
    ],
)
def test_a_wrong_command_line_ends_in_one_line(
    words: list[str], line: str, capsys: Capture
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(words)
    said = capsys.readouterr().err
    assert ended.value.code == 2 and line in said and said.count("\n") == 1


def test_json_stands_alone_on_the_standard_output_or_in_a_file(
    tmp_path: Path, capsys: Capture
) -> None:
    assert main([*INSPECT, "--json", "-"]) == 0
    said = capsys.readouterr()
    assert json.loads(said.out)["format"] == "loose-plan/2" and "forearm" in said.err
    assert main([*INSPECT, "--json", str(tmp_path / "new" / "i.json"), "--verbose"]) == 0
    verbose = capsys.readouterr()
    assert "forearm" in verbose.out and "loose-env" not in verbose.out
    assert f"loose-env {__version__}, Python" in verbose.err and "poses=3" in verbose.err
    assert (tmp_path / "new" / "i.json").read_text("utf-8") == said.out
    few = ["--poses", "3", "--json", "-", "--quiet"]
    assert main(["plan", str(DESK_ARM), "--out", str(tmp_path / "session"), *few]) == 0
    quiet = capsys.readouterr()
    assert json.loads(quiet.out) == read(tmp_path / "session" / "plan.json")


def test_a_json_file_never_overwrites_what_the_command_reads_or_writes(
    in_degrees: Path, tmp_path: Path, capsys: Capture
) -> None:
    model, log = tmp_path / "arm.xml", tmp_path / "log.csv"
    model.write_bytes(DESK_ARM.read_bytes())
    log.write_text("time,x\n0,1\n")
    told = ["diagnose", str(in_degrees), "--out", str(tmp_path / "out"), "--json"]
    for words in (
        ["inspect", str(model), "--json", str(model)],
        [*told, str(tmp_path / "out" / "x.json")],
        [*told, str(in_degrees / "recording.json")],
        ["import", "--guess", f"own={log}", "--json", str(log)],
    ):
        assert "reads or writes" in refused(capsys, *words)
    assert "is a folder" in refused(capsys, *told, str(tmp_path))
    assert model.read_bytes() == DESK_ARM.read_bytes() and not (tmp_path / "out").exists()
    assert log.read_text() == "time,x\n0,1\n"


def test_verbose_keeps_the_trace_of_an_error(tmp_path: Path, capsys: Capture) -> None:
    assert main(["inspect", str(tmp_path / "none.xml"), "--verbose"]) == 1
    said = capsys.readouterr()
    assert "Traceback" in said.err and not said.out
    assert said.err.splitlines()[-1].startswith("loose inspect: ")


@pytest.mark.parametrize("shell", SHELLS)
def test_shells_complete_commands_and_options(shell: str, capsys: Capture) -> None:
    assert main(["--print-completion", shell]) == 0
    script = capsys.readouterr().out
    assert all(name in script for name in (*COMMANDS, "bandwidth-hz", "kinds"))
    if shell != "bash":
        return
    ask = 'COMP_WORDS=({0}); COMP_CWORD={1}; _tyro_loose; printf "%s\\n" "${{COMPREPLY[@]}}"'
    for words, at, wanted in (("loose di", 1, "diagnose"), ("loose gap --kin", 2, "--kinds")):
        done = subprocess.run(
            ["bash", "--norc", "-c", script + ask.format(words, at)],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert wanted in done.stdout.split(), done.stderr


def test_a_reader_that_leaves_early_gets_no_trace() -> None:
    words = " ".join([sys.executable, "-m", "loose_env", "--print-completion", "bash"])
    done = subprocess.run(
        ["bash", "-c", f"{words} | true"], capture_output=True, text=True, check=False
    )
    assert not done.stderr


def test_only_the_folder_of_an_earlier_run_of_the_same_command_is_written_to(
    tmp_path: Path,
) -> None:
    model, out = tmp_path / "model.xml", tmp_path / "out"
    model.write_text("<mujoco/>")
    for folder, words in ((tmp_path, r"model\.xml"), (model, "is a file")):
        with pytest.raises(InvalidSetting, match=words):
            OutputFolder(folder, "gap")

    def mistaken() -> None:
        with (
            pytest.raises(InvalidSetting, match="no such effect"),
            OutputFolder(out, "gap").worked_in() as kept,
        ):
            kept.joinpath("joined.parquet").write_text("recordings")
            raise InvalidSetting("no such effect")

    mistaken()
    assert not out.exists()  # a mistake leaves no folder behind that was not there
    OutputFolder(out, "gap").prepared().joinpath("joined.parquet").write_text("of an earlier run")
    mistaken()
    assert (out / ".gap" / "joined.parquet").exists()
    for name in ("model.xml", ".model.12.part.xml"):
        (out / name).write_text("")
    (out / "result.json").write_text(json.dumps({"format": "loose-gap/1"}))
    said = "holds what 'loose gap' wrote, and 'loose diagnose' would overwrite it"
    with pytest.raises(InvalidSetting, match=said):
        OutputFolder(out, "diagnose")
    OutputFolder(out, "gap")
    out.joinpath("notes.txt").write_text("mine")
    with pytest.raises(InvalidSetting, match=r"notes\.txt"):
        OutputFolder(out, "gap")


def test_the_doctor_lists_findings_and_exits_with_one_at_errors(
    in_degrees: Path, tmp_path: Path, capsys: Capture
) -> None:
    assert main(["doctor", str(in_degrees.parent / "right")]) == 0
    said = capsys.readouterr()
    assert said.out.startswith("right (3 runs, 5.997 s): nothing found") and not said.err
    assert main(["doctor", str(in_degrees), "--json", str(tmp_path / "found.json")]) == 1
    said = capsys.readouterr()
    assert "error: sensor.q_base" in said.out and "remedy:" in said.out
    assert "1 error" in said.out.splitlines()[0]
    assert read(tmp_path / "found.json")["errors"] == 3
    refused(capsys, "doctor", str(tmp_path))
    with pytest.raises(SystemExit) as ended:
        main(["doctor", str(tmp_path), "--clock-s", "-1"])
    assert ended.value.code == 2 and "--clock-s must be positive seconds" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["diagnose", "gap"])
def test_other_commands_stop_at_errors_before_they_write(
    command: str, in_degrees: Path, tmp_path: Path, capsys: Capture
) -> None:
    out = tmp_path / "out"
    assert main([command, str(in_degrees), "--out", str(out), "--quiet"]) == 1
    said = capsys.readouterr().err
    assert "error: sensor.q_base" in said and "--ignore-doctor" in said.splitlines()[-1]
    assert not out.exists()


@pytest.mark.parametrize("format", FORMATS)
def test_the_schemas_of_the_pages_are_those_of_the_formats(format: str) -> None:
    file = Path(__file__).parents[2] / "docs" / "schemas" / f"{format.replace('/', '-')}.json"
    assert read(file) == schema(format)
