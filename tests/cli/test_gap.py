"""``loose gap`` and ``loose export``: what they write, what they refuse, how they say so."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

pytest.importorskip("jinja2")
pytest.importorskip("matplotlib")

from loose_env.cli.main import main
from loose_env.gap import read_result
from loose_env.recording import Recording, write_recording
from loose_env.report import gap_headline
from tests.gap.cases.exported_result import write_result
from tests.gap.cases.gap_case import record

Capture = pytest.CaptureFixture[str]
FEW = ("--kinds", "coulomb_friction", "--no-simulate", "--threads", "1")


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return record(tmp_path_factory.mktemp("cli") / "recording", runs=2)


@pytest.fixture(scope="module")
def more(recording: Recording, tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """One more run of the same machine."""
    place = tmp_path_factory.mktemp("further") / "second"
    runs = [replace(recording.runs[0], name="again.csv")]
    return write_recording(place, model_xml=recording.model_path, runs=runs)


def words(recording: Recording, out: Path, *more: str) -> list[str]:
    return ["gap", str(recording.folder), "--out", str(out), *more]


def refused(capsys: Capture, command: list[str]) -> str:
    """The one line that a command says which refuses what it was given; progress aside."""
    capsys.readouterr()
    try:
        assert main(command) == 1, command
    except SystemExit as end:  # of a value that no option takes
        assert end.code == 2, command
    said = capsys.readouterr()
    (line,) = [line for line in said.err.splitlines() if " s  " not in line]
    assert line.startswith(f"loose {command[0]}: ") and not said.out
    return line


def test_it_writes_model_result_and_page_and_says_what_it_found(
    recording: Recording, tmp_path: Path, capsys: Capture
) -> None:
    out = tmp_path / "out"
    assert main(words(recording, out, *FEW, "--tolerances.mass", "0.04")) == 0
    names = sorted(path.name for path in out.iterdir())
    assert names == [".gap", "model.xml", "report.html", "result.json"]
    found = read_result(out)
    assert found.verdict == "named" and found.settings["tolerances"]["mass"] == 0.04
    said = capsys.readouterr()
    first, *_ = said.out.splitlines()
    assert first == gap_headline(found) == "The model lacks dry friction (elbow)."
    (row,) = (line for line in said.out.splitlines() if line.startswith("  dry friction"))
    assert "torque" in row and "N·m" in row
    assert any(line.split()[:2] == ["shoulder", "not"] for line in said.out.splitlines())
    for stage in ("motion of 2 runs", "force balance", "evidence", "selection", "decision"):
        assert stage in said.err
    # the same folder is written again, and without progress where it is not wanted
    assert main(words(recording, out, *FEW, "--quiet", "--json", "-")) == 0
    said = capsys.readouterr()
    assert not said.err and json.loads(said.out)["format"] == "loose-gap/1"


def test_the_check_says_what_could_be_seen_and_writes_nothing(
    recording: Recording, tmp_path: Path, capsys: Capture
) -> None:
    assert main(["gap", str(recording.folder), "--check", *FEW]) == 0
    said = capsys.readouterr().out
    assert "smallest visible change" in said and "dry friction " in said
    assert [line.split()[0] for line in said.splitlines()[1:3]] == ["shoulder", "elbow"]
    assert main(["gap", str(recording.folder), "--check", *FEW, "--json", "-", "--quiet"]) == 0
    whole = json.loads(capsys.readouterr().out)
    assert whole["format"] == "loose-gap-check/1" and whole["effects"]
    both = words(recording, tmp_path / "out", "--check")
    assert "leave out --out" in refused(capsys, both) and not (tmp_path / "out").exists()


def test_rerun_without_its_package_ends_before_the_search(
    recording: Recording, tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    assert main(words(recording, tmp_path / "out", "--rerun", str(tmp_path / "motion.rrd"))) == 1
    assert "pip install 'loose-env[rerun]'" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_mistakes_end_in_one_line_and_write_nothing(
    recording: Recording, more: Recording, tmp_path: Path, capsys: Capture
) -> None:
    out, broken, other = tmp_path / "out", tmp_path / "broken.xml", tmp_path / "other"
    broken.write_text("<mujoco><worldbody><body></worldbody></mujoco>")
    other.mkdir()
    other.joinpath("notes.txt").write_text("mine")
    first, model = str(recording.folder), str(recording.model_path)
    for command, reason in (
        (["gap", str(tmp_path / "none"), "--out", str(out)], "there is no folder"),
        (["gap", str(tmp_path / "none"), "--out", str(other)], "notes.txt"),
        (words(recording, out, "--tolerances.mass", "nan"), "--tolerances.mass must be positive"),
        (words(recording, out, "--kinds", "rust"), "--kinds: unknown effect 'rust'; there are"),
        (words(recording, out, "--kinds", "paylaod"), "did you mean 'payload'?"),
        (["gap", first, "--check", "--held-out", "run"], "leave out --held-out"),
        (words(recording, out, "--held-out", "run"), "none is left to fit to"),
        (words(recording, out, "--model", str(broken)), "broken.xml"),
        (words(recording, recording.folder), "holds other files"),
        (words(recording, out, "--rerun", str(tmp_path / "motion.mp4")), "ends with .rrd"),
        (["gap", first, first, "--out", str(out)], "given twice"),
        (["gap", model, "--out", str(out)], "give it as --model"),
        (words(recording, out, "--next", "--next-max-speed-rad-s", "nan"), "next-max-speed-rad-s"),
    ):
        assert reason in refused(capsys, command)
        assert not out.exists(), command
    assert [path.name for path in other.iterdir()] == ["notes.txt"]
    heavier = recording.model_path.read_text().replace('mass="', 'mass="1')
    write_recording(tmp_path / "heavier", model_xml=heavier, runs=more.runs)
    both = ["gap", first, str(tmp_path / "heavier"), "--out", str(tmp_path / "next")]
    line = refused(capsys, both)
    assert "models of" in line and "--model" in line


TRUNK = '<body name="trunk"><freejoint/><geom size="0.1" mass="5"/><body name="upper">'
FALLING = (('<body name="upper">', TRUNK), ("</worldbody>", "</body></worldbody>"))
ANOTHER = (("encoder", "gauge"),)


@pytest.mark.parametrize(
    ("spoil", "model", "reason"),
    [
        (lambda rows: [rows[0], *rows[1:2] * (len(rows) - 1)], (), "time"),
        (lambda rows: [rows[0], *(_with(r, 1, "0.3") for r in rows[1:])], (), "nothing moved"),
        (lambda rows: [rows[0], *(_with(r, 1, "nan") for r in rows[1:])], (), "100.0% of 800"),
        (lambda rows: rows[:2], (), "the run has 1 sample; it needs at least 10"),
        (lambda rows: rows, FALLING, "'trunk' is no hinge and no slide; fix that body"),
        (lambda rows: rows, (('kp="', 'kp="-'),), "the model falls or diverges"),
        (lambda rows: rows, ANOTHER, "names nothing in the model; allowed are"),
    ],
    ids=["time stands", "no motion", "NaN", "one sample", "free", "falls", "another machine"],
)
def test_a_recording_that_cannot_be_analysed_ends_in_one_line(
    spoil: Callable[[list[list[str]]], list[list[str]]],
    model: tuple[tuple[str, str], ...],
    reason: str,
    recording: Recording,
    tmp_path: Path,
    capsys: Capture,
) -> None:
    folder = tmp_path / "spoilt"
    shutil.copytree(recording.folder, folder)
    for file in folder.glob("run-*.csv"):
        rows = spoil([line.split(",") for line in file.read_text().splitlines()])
        file.write_text("\n".join(",".join(row) for row in rows) + "\n")
    text = recording.model_path.read_text()
    for old, new in model:
        assert old in text
        text = text.replace(old, new)
    folder.joinpath(recording.model_path.name).write_text(text)
    for more in (["--out", str(tmp_path / "out")], ["--check"]):
        assert reason in refused(capsys, ["gap", str(folder), *more, *FEW])
    assert not (tmp_path / "out").exists()


def _with(row: list[str], first: int, value: str) -> list[str]:
    """A row with one value from some column on."""
    return [*row[:first], *[value] * (len(row) - first)]


def test_runs_of_all_recordings_are_analysed_together(
    recording: Recording, more: Recording, tmp_path: Path, capsys: Capture
) -> None:
    out, third = tmp_path / "out", tmp_path / "third"
    moved = tmp_path / "moved"
    shutil.copytree(recording.folder, moved)
    assert main(["gap", str(moved), "--out", str(out), *FEW]) == 0
    # the output knows its recording
    assert main(["gap", str(out), str(more.folder), "--out", str(third), *FEW]) == 0
    assert "motion of 3 runs" in capsys.readouterr().err
    inside = ["--model", str(out / "result.json")]
    assert "would be overwritten" in refused(capsys, words(recording, out, *inside))
    assert "itself" in refused(capsys, ["gap", str(out), str(more.folder), "--out", str(out)])
    shutil.rmtree(moved)
    again = ["gap", str(out), str(more.folder), "--out", str(tmp_path / "next")]
    assert "which is gone" in refused(capsys, again)
    out.joinpath(".gap", "source.json").write_text(json.dumps({"format": "other"}))
    assert "format" in refused(capsys, again)
    out.joinpath(".gap", "source.json").unlink()
    assert "does not say of which recording" in refused(capsys, again)


@pytest.fixture
def exported(tmp_path: Path) -> Path:
    write_result(tmp_path / "gap")
    return tmp_path / "gap"


def test_files_are_written_and_what_is_lost_is_listed(
    exported: Path, tmp_path: Path, capsys: Capture
) -> None:
    out = tmp_path / "out"
    assert main(["export", str(exported), "--to", "urdf", "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert f"written: {out / 'dynamics.urdf.xml'}" in said
    assert "not expressed by urdf:\n" in said and "backlash at wrist" in said
    command = ["export", str(exported / "result.json"), "--to", "mjlab", "--out", str(out)]
    assert main([*command, "--json", "-", "--quiet"]) == 0
    whole = json.loads(capsys.readouterr().out)
    assert whole["format"] == "loose-export/1" and whole["target"] == "mjlab"
    assert whole["files"] == [str(out / "mjlab_actuators.py")]
    assert any("sensor_gain at encoder2" in words for words in whole["not_expressed"])
    names = sorted(path.name for path in out.iterdir())
    assert names == [".gap", "dynamics.urdf.xml", "mjlab_actuators.py"]


def test_mistakes_of_an_export_write_nothing(
    exported: Path, tmp_path: Path, capsys: Capture
) -> None:
    taken = tmp_path / "taken"
    taken.mkdir()
    taken.joinpath("ranges.json").write_text("mine")
    arm = tmp_path / "arm.urdf"
    arm.write_text("<robot name='arm'/>")
    out = tmp_path / "out"
    for given, reason in (
        ([str(tmp_path), "--to", "ranges", "--out", str(out)], "there is no result"),
        ([str(exported), "--to", "ranges", "--out", str(taken)], "holds other files"),
        ([str(exported), "--to", "bam", "--out", str(out)], "give --servo with one of"),
        ([str(exported), "--to", "mjlab", "--timestep", "0", "--out", str(out)], "timestep"),
        ([str(exported), "--to", "mjlab", "--urdf", str(arm), "--out", str(out)], "--to urdf"),
        ([str(exported), "--to", "urdf", "--urdf", str(arm), "--out", str(out)], "has no joint"),
        ([str(exported), "--to", "urdf", "--urdf", str(arm), "--out", str(arm)], "is a file"),
    ):
        assert reason in refused(capsys, ["export", *given])
    assert not out.exists() and taken.joinpath("ranges.json").read_text() == "mine"
