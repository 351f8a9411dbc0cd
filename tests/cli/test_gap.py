"""The command `loose gap`: what it writes, what it refuses, how it says so."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("jinja2")
pytest.importorskip("matplotlib")

from loose_env.cli import gap
from loose_env.cli.main import main
from loose_env.errors import InvalidData
from loose_env.gap import Gap, GapResult, GapSettings, GapSolution, NamedEffect, read_result
from loose_env.recording import Recording
from loose_env.report import gap_headline, gap_text
from tests.gap.cases.gap_case import record, solution_for


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return record(tmp_path_factory.mktemp("cli") / "recording")


@pytest.fixture(scope="module")
def solution(recording: Recording) -> GapSolution:
    return solution_for(recording)


class Search:
    """Stands for the search, which takes minutes: one stage, then what is known."""

    def __init__(self, solution: GapSolution) -> None:
        self.solution = solution
        self.settings: GapSettings | None = None
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
        self.settings = settings
        say("nominal model: 6.9 noise standard deviations")
        assert stages("base", self.make) == {"rms": 6.9}
        if self.ends is not None:
            raise self.ends
        return self.solution

    def make(self) -> dict[str, float]:
        self.made += 1
        return {"rms": 6.9}


@pytest.fixture
def search(monkeypatch: pytest.MonkeyPatch, solution: GapSolution) -> Search:
    found = Search(solution)
    monkeypatch.setattr(gap, "find_gap", found)
    return found


def words(recording: Recording, out: Path, *more: str) -> list[str]:
    return ["gap", str(recording.folder), "--out", str(out), *more]


def test_it_writes_model_result_and_page_and_says_what_it_found(
    recording: Recording, search: Search, tmp_path: Path, capsys: pytest.CaptureFixture[str]
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


def test_the_motion_is_written_for_rerun_and_known_as_the_commands_own(
    recording: Recording, search: Search, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    out = tmp_path / "out"
    for _ in range(2):  # an earlier file is replaced
        assert main(words(recording, out, "--rerun", str(out / "motion.rrd"))) == 0
        assert (out / "motion.rrd").stat().st_size > 10_000
        assert str(out / "motion.rrd") in capsys.readouterr().out


def test_rerun_without_its_package_or_with_another_name_ends_before_the_search(
    recording: Recording,
    search: Search,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert main(words(recording, tmp_path / "out", "--rerun", str(tmp_path / "motion.mp4"))) == 1
    assert "ends with .rrd" in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "rerun", None)
    assert main(words(recording, tmp_path / "out", "--rerun", str(tmp_path / "motion.rrd"))) == 1
    assert "pip install 'loose-env[rerun]'" in capsys.readouterr().err
    assert search.settings is None and not (tmp_path / "out").exists()


def test_quiet_says_only_the_outcome_and_warnings(
    recording: Recording, search: Search, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words(recording, tmp_path / "out", "--quiet")) == 0
    said = capsys.readouterr()
    first, *others = said.err.splitlines()
    assert first == "warning: the step is coarse" and "written:" in said.out
    assert all(line.startswith("warning: these motions ") or "listed" in line for line in others)


def test_an_interrupted_run_goes_on_from_its_finished_stages(
    recording: Recording, search: Search, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    search.ends = KeyboardInterrupt()
    assert main(words(recording, tmp_path)) == 130
    assert "goes on from there" in capsys.readouterr().err
    search.ends = None
    assert main(words(recording, tmp_path, "--threads", "2")) == 0
    assert search.made == 1
    assert "resumed from checkpoints: base" in capsys.readouterr().err
    assert main(words(recording, tmp_path, "--tolerance", "0.04")) == 0
    assert search.made == 2


def test_a_folder_with_other_files_is_refused_before_anything_is_read(
    search: Search, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tmp_path.joinpath("notes.txt").write_text("mine")
    assert main(["gap", str(tmp_path / "none"), "--out", str(tmp_path)]) == 1
    said = capsys.readouterr()
    assert said.err.startswith("loose gap: --out") and "notes.txt" in said.err
    assert said.err.count("\n") == 1 and not said.out
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_mistakes_end_in_one_line(
    recording: Recording, search: Search, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    broken = tmp_path / "broken.xml"
    broken.write_text("<mujoco><worldbody><body></worldbody></mujoco>")
    for command in (
        ["gap", str(tmp_path / "none"), "--out", str(tmp_path / "out")],
        words(recording, tmp_path / "out", "--tolerance", "3"),
        words(recording, tmp_path / "out", "--model", str(tmp_path / "none.xml")),
        words(recording, tmp_path / "out", "--model", str(broken)),
        words(recording, recording.folder),
    ):
        assert main(command) == 1
        said = capsys.readouterr()
        assert said.err.startswith("loose gap: ") and said.err.count("\n") == 1
        assert "Traceback" not in said.err
    assert not (tmp_path / "out").exists()


def test_a_model_in_the_output_folder_is_not_overwritten(
    recording: Recording, search: Search, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words(recording, tmp_path / "out")) == 0
    model = str(tmp_path / "out" / "model.xml")
    assert main(words(recording, tmp_path / "out", "--model", model)) == 1
    assert "would be overwritten" in capsys.readouterr().err


def test_errors_of_the_search_are_said_and_faults_of_the_program_keep_their_trace(
    recording: Recording, search: Search, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    search.ends = InvalidData("two runs\nare needed")
    assert main(words(recording, tmp_path / "a")) == 1
    assert capsys.readouterr().err.endswith("loose gap: two runs are needed\n")
    search.ends = ZeroDivisionError()
    with pytest.raises(ZeroDivisionError):
        main(words(recording, tmp_path / "b"))


def test_a_command_line_that_makes_no_sense_is_argparses_affair(
    capsys: pytest.CaptureFixture[str],
) -> None:
    for command in (["fly"], ["gap"], ["gap", "here", "--out", "there", "--tolerance", "x"]):
        with pytest.raises(SystemExit) as ended:
            main(command)
        assert ended.value.code == 2
    with pytest.raises(SystemExit) as ended:
        main(["gap", "--help"])
    assert ended.value.code == 0
    assert "Exit codes" in capsys.readouterr().out


def test_what_is_left_is_printed_beside_what_was_named() -> None:
    found = GapResult(
        verdict="named", gap=Gap(before=9.0, after=3.0), remaining=("3 of 9.", "q is off."),
        effects=(NamedEffect(kind="actuator_gain", where="m1", parameters={"gain": 2.0}),),
    )  # fmt: skip
    assert "remaining: 3 of 9.\nremaining: q is off." in gap_text(found)
