"""``loose gap`` and ``loose export``: what they write, what they refuse, how they say so."""

from __future__ import annotations

import json
import shutil
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("jinja2")
pytest.importorskip("matplotlib")

from loose_env.cli import gap
from loose_env.cli.main import main
from loose_env.gap import (
    GapResult,
    GapSettings,
    GapSolution,
    read_result,
    result_of,
)
from loose_env.recording import Recording, write_recording
from loose_env.report import gap_headline
from tests.gap.cases.exported_result import write_result
from tests.gap.cases.gap_case import record, solution_for

Capture = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return record(tmp_path_factory.mktemp("cli") / "recording")


@pytest.fixture(scope="module")
def more(recording: Recording, tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """Two more runs of the same machine."""
    place = tmp_path_factory.mktemp("further") / "second"
    runs = [replace(run, name=f"again-{k}.csv") for k, run in enumerate(recording.runs[:2])]
    return write_recording(place, model_xml=recording.model_path, runs=runs)


@pytest.fixture(scope="module")
def solution(recording: Recording) -> GapSolution:
    return solution_for(recording)


class Search:
    """Stands for the search, which takes minutes: one stage, then what is known."""

    def __init__(self, solution: GapSolution) -> None:
        self.solution = solution
        self.recording: Recording | None = None
        self.settings: GapSettings | None = None
        self.earlier: GapResult | None = None
        self.made = 0
        self.ends: BaseException | None = None

    def __call__(
        self,
        recording: Recording,
        settings: GapSettings,
        *,
        say: Any,
        stages: Any,
        earlier: GapResult | None = None,
    ) -> GapSolution:
        self.recording, self.settings, self.earlier = recording, settings, earlier
        say("nominal model: 6.9 noise standard deviations")
        assert stages("base", self.make) == {"rms": 6.9}
        if self.ends is not None:
            raise self.ends
        return replace(self.solution, problem=replace(self.solution.problem, settings=settings))

    def make(self) -> dict[str, float]:
        self.made += 1
        return {"rms": 6.9}


@pytest.fixture
def search(monkeypatch: pytest.MonkeyPatch, solution: GapSolution) -> Search:
    found = Search(solution)
    monkeypatch.setattr(gap, "find_gap", found)
    return found


@pytest.fixture
def bare(search: Search, monkeypatch: pytest.MonkeyPatch) -> Search:
    """The search, with the result as the only file that is written."""

    def write(folder: Path, solution: GapSolution, **_: Any) -> tuple[GapResult, list[Path]]:
        result = result_of(solution)
        return result, [result.write(folder / "result.json")]

    monkeypatch.setattr(gap, "write_gap", write)
    return search


def words(recording: Recording, out: Path, *more: str) -> list[str]:
    return ["gap", str(recording.folder), "--out", str(out), *more]


def refused(capsys: Capture, command: list[str]) -> str:
    """The one line that a command says which refuses what it was given; progress aside."""
    capsys.readouterr()
    assert main(command) == 1, command
    said = capsys.readouterr()
    (line,) = [line for line in said.err.splitlines() if " s  " not in line]
    assert line.startswith(f"loose {command[0]}: ") and not said.out
    return line


def test_it_writes_model_result_and_page_and_says_what_it_found(
    recording: Recording, search: Search, tmp_path: Path, capsys: Capture
) -> None:
    assert main(words(recording, tmp_path / "out", "--tolerance", "0.05", "--threads", "1")) == 0
    assert search.settings == GapSettings(tolerance=0.05, threads=1)
    names = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert names == [".gap", "model.xml", "report.html", "result.json"]
    assert read_result(tmp_path / "out").verdict == "named"
    said = capsys.readouterr()
    first, *_ = said.out.splitlines()
    assert first == gap_headline(read_result(tmp_path / "out"))
    (row,) = (line for line in said.out.splitlines() if "viscous friction (joint2)" in line[:40])
    assert "damping" in row and "2.9 to 3.1" in row and "another gain (servo2)" in row
    assert "nominal model: 6.9" in said.err and "warning: the step is coarse" in said.err
    assert "the step is coarse" not in said.out


def test_rerun_without_its_package_ends_before_the_search(
    recording: Recording,
    search: Search,
    tmp_path: Path,
    capsys: Capture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    assert main(words(recording, tmp_path / "out", "--rerun", str(tmp_path / "motion.rrd"))) == 1
    assert "pip install 'loose-env[rerun]'" in capsys.readouterr().err
    assert search.settings is None and not (tmp_path / "out").exists()


def test_an_interrupted_run_goes_on_from_its_finished_stages(
    recording: Recording, bare: Search, tmp_path: Path, capsys: Capture
) -> None:
    bare.ends = KeyboardInterrupt()
    assert main(words(recording, tmp_path)) == 130
    assert "goes on from there" in capsys.readouterr().err
    bare.ends = None
    assert main(words(recording, tmp_path, "--threads", "2")) == 0
    assert bare.made == 1
    assert "resumed from checkpoints: base" in capsys.readouterr().err
    assert main(words(recording, tmp_path, "--tolerance", "0.04", "--quiet")) == 0
    assert bare.made == 2
    said = capsys.readouterr()
    assert said.err.splitlines()[0] == "warning: the step is coarse" and "written:" in said.out
    assert all(line.startswith("warning: ") for line in said.err.splitlines())


def test_mistakes_end_in_one_line_and_write_nothing(
    recording: Recording, more: Recording, bare: Search, tmp_path: Path, capsys: Capture
) -> None:
    out, broken, other = tmp_path / "out", tmp_path / "broken.xml", tmp_path / "other"
    broken.write_text("<mujoco><worldbody><body></worldbody></mujoco>")
    other.mkdir()
    other.joinpath("notes.txt").write_text("mine")
    first, model = str(recording.folder), str(recording.model_path)
    for command, reason in (
        (["gap", str(tmp_path / "none"), "--out", str(out)], "there is no folder"),
        (["gap", str(tmp_path / "none"), "--out", str(other)], "notes.txt"),
        (words(recording, out, "--tolerance", "3"), "tolerance"),
        (words(recording, out, "--model", str(broken)), "broken.xml"),
        (words(recording, recording.folder), "holds other files"),
        (words(recording, out, "--rerun", str(tmp_path / "motion.mp4")), "ends with .rrd"),
        (["gap", first, first, "--out", str(out)], "given twice"),
        (["gap", model, "--out", str(out)], "give it as --model"),
        (words(recording, out, "--next", "--next-max-speed-rad-s", "nan"), "next-max-speed-rad-s"),
    ):
        assert reason in refused(capsys, command)
    assert bare.settings is None and not out.exists()
    assert [path.name for path in other.iterdir()] == ["notes.txt"]
    assert main(words(recording, out)) == 0
    inside = ["--model", str(out / "result.json")]
    assert "would be overwritten" in refused(capsys, words(recording, out, *inside))
    assert "itself" in refused(capsys, ["gap", str(out), str(more.folder), "--out", str(out)])
    heavier = recording.model_path.read_text().replace('mass="', 'mass="1')
    write_recording(tmp_path / "heavier", model_xml=heavier, runs=more.runs)
    both = ["gap", first, str(tmp_path / "heavier"), "--out", str(tmp_path / "next")]
    line = refused(capsys, both)
    assert "models of" in line and "--model" in line


def test_runs_of_all_recordings_are_compared_and_the_last_of_each_held_out(
    recording: Recording, more: Recording, bare: Search, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    given = ["--tolerance", "0.05", "--kinds", "viscous_friction", "sensor_gain"]
    assert main(["gap", str(recording.folder), str(more.folder), "--out", str(out), *given]) == 0
    assert bare.recording is not None and bare.earlier is None
    names = [run.name for run in bare.recording.runs]
    own = [run.name for run in recording.runs]
    assert len(names) == len(own) + 2 and names[-2:] == ["next2-again-0.parquet", names[-1]]
    assert bare.settings is not None and bare.settings.held_out == (
        names[len(own) - 1],
        "next2-again-1.parquet",
    )
    # The output knows its recording, and a third one is added to all runs so far.
    third = ["gap", str(out), str(more.folder), "--out", str(tmp_path / "third")]
    assert main([*third, "--tolerance", "0.02"]) == 0
    assert bare.settings.tolerance == 0.02  # and what is not given is as it was
    assert bare.settings.kinds == ("viscous_friction", "sensor_gain")
    assert bare.recording.folder != out
    assert len(bare.recording.runs) == len(names) + 2
    assert bare.earlier is not None and bare.earlier.verdict == "named"


def test_an_output_whose_recording_is_gone_says_so(
    recording: Recording, bare: Search, tmp_path: Path, capsys: Capture
) -> None:
    moved, out = tmp_path / "moved", tmp_path / "out"
    shutil.copytree(recording.folder, moved)
    assert main(["gap", str(moved), "--out", str(out)]) == 0
    shutil.rmtree(moved)
    again = ["gap", str(out), str(recording.folder), "--out", str(tmp_path / "next")]
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
        ([str(tmp_path / "none"), "--to", "ranges", "--out", str(out)], "none"),
        ([str(exported), "--to", "ranges", "--out", str(taken)], "holds other files"),
        ([str(exported), "--to", "bam", "--out", str(out)], "give --servo with one of"),
        ([str(exported), "--to", "mjlab", "--timestep", "0", "--out", str(out)], "timestep"),
        ([str(exported), "--to", "mjlab", "--urdf", str(arm), "--out", str(out)], "--to urdf"),
        ([str(exported), "--to", "urdf", "--urdf", str(arm), "--out", str(out)], "has no joint"),
        ([str(exported), "--to", "urdf", "--urdf", str(arm), "--out", str(arm)], "is a file"),
    ):
        assert reason in refused(capsys, ["export", *given])
    assert not out.exists() and taken.joinpath("ranges.json").read_text() == "mine"
