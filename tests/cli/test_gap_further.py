"""`loose gap A B`: several recordings as one, and what an earlier output passes on."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("jinja2")
pytest.importorskip("matplotlib")

from loose_env.cli import gap
from loose_env.cli.main import main
from loose_env.gap import GapResult, GapSettings, GapSolution, result_of
from loose_env.recording import Recording, read_recording, write_recording
from tests.gap.cases.gap_case import record, solution_for


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return record(tmp_path_factory.mktemp("further") / "first")


@pytest.fixture(scope="module")
def more(recording: Recording, tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """Two more runs of the same machine."""
    place = tmp_path_factory.mktemp("further") / "second"
    runs = [replace(run, name=f"again-{k}.csv") for k, run in enumerate(recording.runs[:2])]
    return write_recording(place, model_xml=recording.model_path, runs=runs)


class Search:
    """Stands for the search; keeps what it was given."""

    def __init__(self, solution: GapSolution) -> None:
        self.solution = solution
        self.recording: Recording | None = None
        self.settings = GapSettings()
        self.earlier: GapResult | None = None

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
        problem = replace(self.solution.problem, settings=settings)
        return replace(self.solution, problem=problem)


def write(folder: Path, solution: GapSolution, **_: Any) -> tuple[GapResult, list[Path]]:
    """Stands for the diagnosis and its files: the result alone."""
    result = result_of(solution)
    return result, [result.write(folder / "result.json")]


@pytest.fixture(scope="module")
def solution(recording: Recording) -> GapSolution:
    return solution_for(recording)


@pytest.fixture
def search(monkeypatch: pytest.MonkeyPatch, solution: GapSolution) -> Search:
    found = Search(solution)
    monkeypatch.setattr(gap, "find_gap", found)
    monkeypatch.setattr(gap, "write_gap", write)
    return found


def test_runs_of_all_recordings_are_compared_and_the_last_of_each_held_out(
    recording: Recording, more: Recording, search: Search, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    assert main(["gap", str(recording.folder), str(more.folder), "--out", str(out)]) == 0
    assert search.recording is not None and search.earlier is None
    names = [run.name for run in search.recording.runs]
    own = [run.name for run in recording.runs]
    assert len(names) == len(own) + 2 and names[-2:] == ["next2-again-0.parquet", names[-1]]
    assert search.settings.held_out == (names[len(own) - 1], "next2-again-1.parquet")
    # The output knows its recording, and a third one is added to all runs so far.
    third = ["gap", str(out), str(more.folder), "--out", str(tmp_path / "third")]
    assert main(third) == 0
    assert search.recording.folder != out
    assert len(search.recording.runs) == len(names) + 2
    assert search.earlier is not None and search.earlier.verdict == "named"


def test_settings_of_an_earlier_output_hold_unless_others_are_given(
    recording: Recording, more: Recording, search: Search, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    given = ["--tolerance", "0.05", "--kinds", "viscous_friction", "sensor_gain"]
    assert main(["gap", str(recording.folder), "--out", str(out), *given]) == 0
    again = ["gap", str(out), str(more.folder), "--out", str(tmp_path / "next")]
    assert main([*again, "--tolerance", "0.02"]) == 0
    assert search.settings.tolerance == 0.02
    assert search.settings.kinds == ("viscous_friction", "sensor_gain")


def refused(words: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    assert main(words) == 1
    lines = [line for line in capsys.readouterr().err.splitlines() if " s  " not in line]
    assert len([line for line in lines if line.startswith("loose")]) == 1, lines
    return lines[-1]


def test_bad_input_is_refused_in_one_line(
    recording: Recording,
    more: Recording,
    search: Search,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    first, out = str(recording.folder), str(tmp_path / "out")
    assert "given twice" in refused(["gap", first, first, "--out", out], capsys)
    model = str(recording.model_path)
    assert "a model is --model" in refused(["gap", first, model, "--out", out], capsys)
    assert "give it as --model" in refused(["gap", model, "--out", out], capsys)
    both = ["gap", first, "--out", out, "--quick", "--next"]
    assert "names nothing" in refused(both, capsys)
    assert main(["gap", first, "--out", out]) == 0
    capsys.readouterr()
    assert "itself" in refused(["gap", out, str(more.folder), "--out", out], capsys)
    out = str(tmp_path / "next")
    other = tmp_path / "other"
    text = recording.model_path.read_text().replace('mass="', 'mass="1')
    write_recording(other, model_xml=text, runs=more.runs)
    words = refused(["gap", first, str(other), "--out", out], capsys)
    assert "models of" in words and "--model" in words
    assert "next_seconds" in refused(
        ["gap", first, "--out", out, "--next", "--next-seconds", "0"], capsys
    )


def test_an_output_whose_recording_is_gone_says_so(
    recording: Recording, search: Search, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    moved, out = tmp_path / "moved", tmp_path / "out"
    shutil.copytree(recording.folder, moved)
    assert main(["gap", str(moved), "--out", str(out)]) == 0
    shutil.rmtree(moved)
    again = ["gap", str(out), str(recording.folder), "--out", str(tmp_path / "next")]
    assert "which is gone" in refused(again, capsys)
    out.joinpath(".gap", "source.json").write_text(json.dumps({"format": "other"}))
    assert "format" in refused(again, capsys)
    out.joinpath(".gap", "source.json").unlink()
    assert "does not say of which recording" in refused(again, capsys)
    assert read_recording(recording.folder).runs


def test_settings_of_the_next_motion_are_checked_before_the_search(
    recording: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    def search(*_: Any, **__: Any) -> GapSolution:
        raise AssertionError("searched with settings that are refused")

    monkeypatch.setattr(gap, "find_gap", search)
    place = str(recording.model_path.parent)
    out = tmp_path / "out"
    code = main(["gap", place, "--out", str(out), "--next", "--next-max-speed-rad-s", "nan"])
    assert code == 1
    assert "next-max-speed-rad-s" in capsys.readouterr().err.replace("_", "-")
    assert not out.exists()
