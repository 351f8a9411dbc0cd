"""What all commands share: verbosity, JSON on the standard output, completion, help."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from loose_env.arms import DESK_ARM
from loose_env.cli.main import COMMANDS, SHELLS, main
from loose_env.version import __version__
from scripts.example_recording import loose_arm

INSPECT = ["inspect", str(DESK_ARM), "--poses", "2"]


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return loose_arm(tmp_path_factory.mktemp("cli") / "recording").folder


def called(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *words], capture_output=True, text=True, check=False, timeout=120
    )


def refused(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    """The one line that a command says which refuses what it was given."""
    assert main(words) == 1
    said = capsys.readouterr()
    assert not said.out and said.err.count("\n") == 1
    return said.err


def test_the_module_is_the_command() -> None:
    done = called("-m", "loose_env", "--version")
    assert (done.returncode, done.stdout, done.stderr) == (0, f"loose-env {__version__}\n", "")


def test_the_version_is_said_without_loading_what_computes() -> None:
    code = (
        "import sys\nfrom loose_env.cli.main import main\n"
        "try:\n    main(['--version'])\nexcept SystemExit:\n    pass\n"
        "print(sorted({'mujoco', 'scipy', 'pyarrow'} & set(sys.modules)))"
    )
    assert called("-c", code).stdout == f"loose-env {__version__}\n[]\n"


def test_the_command_alone_prints_its_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    said = capsys.readouterr()
    assert said.out.startswith("usage: loose") and not said.err
    assert all(f"\n  {name} " in said.out for name in COMMANDS)



@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_the_options_of_output(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main([name, "--help"])
    assert ended.value.code == 0
    said = capsys.readouterr().out
    assert "--json FILE" in said and "--quiet" in said and "--verbose" in said
    with pytest.raises(SystemExit) as ended:
        main([name, "--quiet", "--verbose"])
    assert ended.value.code == 2
    assert "--quiet and --verbose exclude each other" in capsys.readouterr().err


def test_json_on_the_standard_output_stands_alone(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*INSPECT, "--json", "-"]) == 0
    said = capsys.readouterr()
    assert json.loads(said.out)["format"] == "loose-inspection/1"
    assert "modes of the held arm" in said.err
    assert main([*INSPECT, "--json", "-", "--quiet"]) == 0
    said = capsys.readouterr()
    assert json.loads(said.out)["joints"] and not said.err


def test_json_in_a_file_is_the_same_and_the_text_stays(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*INSPECT, "--json", "-"]) == 0
    document = capsys.readouterr().out
    assert main([*INSPECT, "--json", str(tmp_path / "new" / "i.json")]) == 0
    assert "modes of the held arm" in capsys.readouterr().out
    assert (tmp_path / "new" / "i.json").read_text("utf-8") == document


def test_plan_and_diagnosis_print_the_content_of_their_files(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    few = ["--poses", "2", "--seconds", "1.2", "--json", "-"]
    assert main(["plan", str(DESK_ARM), "--out", str(tmp_path / "session"), *few]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == read(tmp_path / "session" / "plan.json")
    assert main(["diagnose", str(recording), "--out", str(tmp_path / "found"), *few]) == 0
    said = capsys.readouterr()
    assert json.loads(said.out) == read(tmp_path / "found" / "result.json")
    assert json.loads(said.out)["fault"]["where"] == "forearm"
    assert "Link 3 (forearm) is loose." in said.err and "written: " in said.err


def read(path: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(path.read_text("utf-8"))
    return found


def test_import_says_what_was_read_and_described(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "model.xml").write_text(
        '<mujoco><worldbody><body><joint name="elbow"/><geom size=".1"/></body></worldbody>'
        '<sensor><jointpos name="angle" joint="elbow"/></sensor></mujoco>'
    )
    lines = [f"{k / 100:.2f},{0.1 + 0.001 * k:.3f}" for k in range(40)]
    (tmp_path / "daq.csv").write_text("\n".join(["time [s],elbow [rad]", *lines]) + "\n")
    source = str(tmp_path / "daq.csv")
    assert main(["import", "--describe", source, "--json", "-"]) == 0
    (stream,) = json.loads(capsys.readouterr().out)["sources"]["daq"]["streams"]
    assert [each["channel"] for each in stream["channels"]] == ["time [s]", "elbow [rad]"]
    assert stream["channels"][1]["unit"] == "rad"
    mapping = tmp_path / "map.toml"
    mapping.write_text(
        'format = "loose-mapping/1"\nmodel = "model.xml"\n[sources.daq]\nfile = "daq.csv"\n'
        'kind = "csv"\ntime = { column = "time [s]", unit = "s" }\n[columns]\n'
        '"sensor.angle" = { source = "daq", channel = "elbow [rad]" }\n'
        '[[runs]]\nfile = "run-01"\n'
    )
    out = str(tmp_path / "arm")
    assert main(["import", source, "--mapping", str(mapping), "--out", out, "--json", "-"]) == 0
    (run,) = json.loads(capsys.readouterr().out)["runs"]
    assert (run["samples"], run["sensors"], run["condition"]) == (40, ["angle"], "suspect")
    assert run["rate_hz"] == pytest.approx(100.0)


def test_a_json_file_never_overwrites_what_the_command_reads_or_writes(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = tmp_path / "arm.xml"
    model.write_bytes(DESK_ARM.read_bytes())
    assert "reads or writes" in refused(capsys, "inspect", str(model), "--json", str(model))
    assert model.read_bytes() == DESK_ARM.read_bytes()
    told = ["diagnose", str(recording), "--out", str(tmp_path / "out"), "--json"]
    assert "reads or writes" in refused(capsys, *told, str(tmp_path / "out" / "x.json"))
    assert "reads or writes" in refused(capsys, *told, str(recording / "recording.json"))
    assert "is a folder" in refused(capsys, *told, str(tmp_path))
    log = tmp_path / "log.csv"
    log.write_text("time,x\n0,1\n")
    asked = ["import", "--describe", f"own={log}", "--json", str(log)]
    assert "reads or writes" in refused(capsys, *asked)
    assert log.read_text() == "time,x\n0,1\n" and not (tmp_path / "out").exists()


def test_verbose_says_versions_and_settings_and_keeps_the_trace_of_an_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*INSPECT, "--verbose"]) == 0
    said = capsys.readouterr()
    assert f"loose-env {__version__}, Python" in said.err and "poses=2" in said.err
    assert "loose-env" not in said.out
    assert main(["inspect", str(tmp_path / "none.xml"), "--verbose"]) == 1
    said = capsys.readouterr()
    assert "Traceback" in said.err
    assert said.err.splitlines()[-1].startswith("loose inspect: ") and not said.out


@pytest.mark.parametrize("shell", SHELLS)
def test_shells_complete_commands_and_options(
    shell: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["--print-completion", shell])
    assert ended.value.code == 0
    said = capsys.readouterr().out
    assert all(name in said for name in COMMANDS)
    assert "most-tool" in said and "kinds" in said


def test_bash_completes_a_command_and_its_options() -> None:
    script = called("-m", "loose_env", "--print-completion", "bash").stdout
    ask = 'COMP_WORDS=({0}); COMP_CWORD={1}; _tyro_loose; printf "%s\\n" "${{COMPREPLY[@]}}"'
    for words, at, wanted in (("loose di", 1, "diagnose"), ("loose gap --kin", 2, "--kinds")):
        done = subprocess.run(
            ["bash", "--norc", "-c", script + ask.format(words, at)],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert wanted in done.stdout.split(), done.stderr


def test_a_reader_that_leaves_early_gets_no_trace() -> None:
    words = " ".join([sys.executable, "-m", "loose_env", *INSPECT])
    done = subprocess.run(
        ["bash", "-c", f"{words} | true"], capture_output=True, text=True, check=False
    )
    assert not done.stderr
