"""The suite runs, resumes, keeps the truth sealed, and turns what goes wrong into rows."""

from __future__ import annotations

import json
import os
import re
import signal
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("numba")

from loose_agents.execution.backends import BackendSettings

from loose_env.errors import InvalidSetting
from loose_env.gap import read_result
from scripts.suites.gap import run as script
from scripts.suites.gap.cases import cases
from scripts.suites.gap.cases import full_list, name_of, quick_list, role_of
from scripts.suites.gap.grading import one_case
from scripts.suites.gap.grading.one_case import Folders, grade_of, run_case, shard_for
from scripts.suites.gap.grading.tool import EXPORTED, run_tool

NUMBERS = [0, 1, 1000, 1001, 3000]
SAID = {0: "no_gap", 1: "payload", 1000: "payload", 1001: "backlash", 3000: "unexplained"}
PAYLOAD = {
    "kind": "payload",
    "where": "tool",
    "parameters": {"mass": 1.0},
    "size": {"ratio": 3.0},
}
THREADS = BackendSettings(backend="threading", workers=1)


def write_blind(folder: Path, numbers: list[int] = NUMBERS) -> Folders:
    """Recordings that hold nothing but what the stub is to say of them, and their truth."""
    folders = Folders(out=folder / "out", blind=folder / "blind", keep=True)
    folders.truth.mkdir(parents=True)
    for number in numbers:
        name, role = name_of(number), role_of(number)
        recording = folders.recordings / name
        recording.mkdir(parents=True)
        content = {"say": SAID[number], "number": number}
        (recording / "recording.json").write_text(json.dumps(content))
        effects = {"none": [], "outside": [{**PAYLOAD, "kind": "shaking_force"}]}
        truth = {
            "format": "gap-truth/1",
            "case": name,
            "role": role,
            "form": "forward",
            "effects": effects.get(role, [PAYLOAD]),
        }
        (folders.truth / f"{name}.json").write_text(json.dumps(truth))
    return folders


def stub(recording: Path, folder: Path, tolerance: float = 0.03) -> None:
    """Say what stands in the recording."""
    said = json.loads((recording / "recording.json").read_text())["say"]
    known = said in ("no_gap", "unexplained")
    effect = {**PAYLOAD, "kind": said, "interval_95": {"mass": [0.9, 1.2]}}
    result = {
        "format": "loose-gap/1",
        "verdict": said if known else "named",
        "effects": [] if known else [effect],
        "gap": {"before": 3.0, "after": 1.1},
    }
    (folder / "result.json").write_text(json.dumps(result))


def number_of(recording: Path) -> int:
    return int(json.loads((recording / "recording.json").read_text())["number"])


def noted(notes: Path, recording: Path, folder: Path, tolerance: float = 0.03) -> None:
    """The stub, with a note of every call."""
    stub(recording, folder)
    with (notes / recording.name).open("a") as file:
        file.write("x")


def calls(notes: Path) -> dict[str, int]:
    return {path.name: len(path.read_text()) for path in notes.iterdir()}


def failing(notes: Path, recording: Path, folder: Path, tolerance: float = 0.03) -> None:
    noted(notes, recording, folder)
    if number_of(recording) == 1000 and not (notes.parent / "mended").exists():
        raise ValueError("the step\nis too coarse")


def dying(notes: Path, times: int, recording: Path, folder: Path, tolerance: float = 0.03) -> None:
    """Kill the worker of one case the first times."""
    deaths = notes.parent / "deaths"
    deaths.mkdir(exist_ok=True)
    count = len(list(deaths.iterdir()))
    if number_of(recording) == 1001 and count < times:
        (deaths / str(count)).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    noted(notes, recording, folder)


def silent(recording: Path, folder: Path, tolerance: float = 0.03) -> None:
    """Leave no result."""


def suite(folders: Folders, tool: Any = stub, numbers: list[int] = NUMBERS, **options: Any) -> Any:
    backend = BackendSettings(**options) if options else THREADS
    store = script.store_in(folders.out)
    return script.run_suite(numbers, folders, store, tool=tool, backend=backend)


def without_times(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    found = [{**row, "times": None, "grade": {**row["grade"], "seconds": None}} for row in rows]
    assert "NaN" in json.dumps(found)  # which is not equal to itself
    return [json.loads(json.dumps(row), parse_constant=str) for row in found]


@pytest.fixture(scope="module")
def configuration() -> dict[str, Any]:
    return script.configuration()


@pytest.fixture(autouse=True)
def same_code(monkeypatch: pytest.MonkeyPatch, configuration: dict[str, Any]) -> None:
    """Somebody who edits the tool while the tests run must not make them fail."""
    monkeypatch.setattr(script, "configuration", lambda *tool: configuration)


@pytest.fixture
def notes(tmp_path: Path) -> Path:
    folder = tmp_path / "notes"
    folder.mkdir()
    return folder


def test_cases_are_graded_and_stand_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    rows = suite(write_blind(tmp_path), numbers=NUMBERS[::-1])
    assert [row["number"] for row in rows] == NUMBERS
    assert [row["grade"]["right"] for row in rows] == [True, False, True, False, True]
    marks = grade_of(rows[2])
    assert (marks.said, marks.covered, marks.gap_after) == ((("payload", "tool"),), (True,), 1.1)
    assert marks.seconds == rows[2]["times"]["tool"]
    assert not any(row["error"] for row in rows)


def test_rows_are_the_same_for_any_number_of_workers(tmp_path: Path) -> None:
    found = []
    for workers in (1, 3):
        place = tmp_path / str(workers)
        place.mkdir()
        found.append(suite(write_blind(place), backend="threading", workers=workers))
    assert without_times(found[0]) == without_times(found[1])


def test_a_run_cut_short_goes_on_where_it_stopped(
    tmp_path: Path, notes: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folders = write_blind(tmp_path)
    printed: list[str] = []

    def interrupting(line: str) -> None:
        printed.append(line)
        if len(printed) == 2:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(script, "_say", interrupting)
        with pytest.raises(KeyboardInterrupt):
            suite(folders, partial(noted, notes))
    done = script.stored(NUMBERS, script.store_in(folders.out))
    assert len(done) == 2
    before = calls(notes)
    rows = suite(folders, partial(noted, notes))
    assert [row["number"] for row in rows] == NUMBERS
    for row in done:
        assert calls(notes)[row["case"]] == before[row["case"]]
    assert suite(folders, partial(noted, notes)) and sum(calls(notes).values()) <= 6


def test_an_exception_is_a_row_and_can_be_tried_again(
    tmp_path: Path, notes: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    folders = write_blind(tmp_path)
    rows = suite(folders, partial(failing, notes))
    assert [row["number"] for row in rows] == NUMBERS
    failed = rows[2]
    assert failed["error"] == "tool: ValueError: the step is too coarse"
    assert grade_of(failed).truth == (("payload", "tool"),)
    assert not grade_of(failed).right
    assert "Traceback" in (folders.results(failed["case"]) / "error.txt").read_text()
    assert "FAILED" in capsys.readouterr().out
    report = script.report(rows, 5)
    assert "1/5 = 20 %" in report and "the step is too coarse" in report

    (tmp_path / "mended").touch()
    monkeypatch.setattr(script, "tool_named", lambda name: partial(failing, notes))
    chosen = ["--numbers", *map(str, NUMBERS), "--out", str(folders.out)]
    chosen += ["--blind", str(folders.blind), "--backend", "threading", "--workers", "1"]
    script.main(chosen)
    assert set(calls(notes).values()) == {1}
    script.main([*chosen, "--retry-failed"])
    assert calls(notes).pop(failed["case"]) == 2
    assert sum(calls(notes).values()) == 6
    assert "failed:" not in capsys.readouterr().out.partition("--retry")[2]
    assert not any(r["error"] for r in script.stored(NUMBERS, script.store_in(folders.out)))


def test_a_killed_worker_loses_and_doubles_no_row(tmp_path: Path, notes: Path) -> None:
    folders = write_blind(tmp_path)
    rows = suite(folders, partial(dying, notes, 1), backend="loky", workers=2)
    assert len(list((tmp_path / "deaths").iterdir())) == 1
    undisturbed = tmp_path / "undisturbed"
    undisturbed.mkdir()
    assert without_times(rows) == without_times(suite(write_blind(undisturbed)))


def test_a_case_that_always_kills_its_worker_is_a_row(tmp_path: Path, notes: Path) -> None:
    folders = write_blind(tmp_path, [1000, 1001])
    tool = partial(dying, notes, 99)
    rows = suite(folders, tool, [1000, 1001], backend="loky", workers=1, retries=0)
    assert [bool(row["error"]) for row in rows] == [False, True]
    assert rows[1]["error"].startswith("worker: ") and "SIGKILL" in rows[1]["error"]
    assert grade_of(rows[1]).role == "single"


def test_the_truth_is_opened_after_the_result_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folders = write_blind(tmp_path, [1000])
    name = name_of(1000)
    order: list[str] = []
    read = one_case.read_truth

    def watched(given: Folders, case: str) -> dict[str, Any]:
        assert (folders.results(case) / "result.json").exists()
        order.append("truth")
        return read(given, case)

    def tool(*given: Any) -> None:
        assert given == (folders.recordings / name, folders.results(name), 0.03)
        order.append("tool")
        stub(*given)

    monkeypatch.setattr(one_case, "read_truth", watched)
    (row,) = run_case(shard_for(1000), folders=folders, tool=tool)
    assert order == ["tool", "truth"] and not row["error"]


def test_an_old_result_is_not_graded_for_a_new_one(tmp_path: Path) -> None:
    folders = write_blind(tmp_path, [1000])
    assert not run_case(shard_for(1000), folders=folders, tool=stub)[0]["error"]
    (row,) = run_case(shard_for(1000), folders=folders, tool=silent)
    assert row["error"].startswith("grading: FileNotFoundError")


def test_recordings_go_when_graded_unless_kept(tmp_path: Path) -> None:
    kept = write_blind(tmp_path, [0])
    run_case(shard_for(0), folders=kept, tool=stub)
    assert (kept.recordings / name_of(0)).is_dir()
    run_case(shard_for(0), folders=Folders(out=kept.out, blind=kept.blind), tool=stub)
    assert not (kept.recordings / name_of(0)).exists()
    assert (kept.truth / f"{name_of(0)}.json").is_file()


def test_rows_of_other_code_are_not_mixed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, configuration: dict[str, Any]
) -> None:
    folders = write_blind(tmp_path)
    suite(folders)
    other = {**configuration, "tool": "another"}
    monkeypatch.setattr(script, "configuration", lambda *tool: other)
    with pytest.raises(InvalidSetting, match=r"tool is .*\(--afresh"):
        script.store_in(folders.out)
    assert not script.stored(NUMBERS, script.store_in(folders.out, afresh=True))


@pytest.mark.parametrize("word", ["x", "-1", "3-1", "6000", "1-2-3", "1.5"])
def test_what_is_no_case_is_refused(word: str) -> None:
    with pytest.raises(InvalidSetting, match="case"):
        script.numbers_of([word])


@pytest.mark.parametrize("numbers", [quick_list(), full_list()])
def test_a_run_cut_short_has_a_little_of_every_role(numbers: list[int]) -> None:
    order = script.mixed(numbers)
    assert sorted(order) == sorted(numbers)
    half = [role_of(n) for n in order[: len(order) // 2]]
    for role in ("none", "single", "pair", "outside"):
        whole = sum(role_of(n) == role for n in numbers)
        assert abs(half.count(role) - whole / 2) <= 1


def test_the_page_is_made_and_its_tables_renewed(tmp_path: Path) -> None:
    rows = suite(write_blind(tmp_path))
    page = tmp_path / "docs" / "gap_suite.md"
    script.write_between(page, script.tables(rows, 5), new=script.NEW)
    first = page.read_text()
    assert "| 11\N{NO-BREAK SPACE}payload |" in first
    assert "| 1001 | " in first and "| 1000 | " not in first
    page.write_text(first + "A last line.\n")
    script.write_between(page, script.tables(rows[:1], 5))
    second = page.read_text()
    assert second.endswith("A last line.\n") and "1 case of 5" in second
    assert "payload |" not in second and second.count("tables: begin") == 1
    page.write_text("no marks")
    with pytest.raises(InvalidSetting, match="lacks"):
        script.write_between(page, "")


def test_the_command_shows_what_is_stored(tmp_path: Path, capsys: Any) -> None:
    folders = write_blind(tmp_path)
    suite(folders, numbers=NUMBERS[:3])
    page = tmp_path / "page.md"
    out = ["--out", str(folders.out), "--docs", str(page)]
    script.main(["--show", "--numbers", "0-1", "1000", "1001", *out])
    assert "3 cases of 4" in capsys.readouterr().out
    assert "3 cases of 4" in page.read_text()
    assert len((folders.out / "cases.txt").read_text().splitlines()) == 3
    with pytest.raises(SystemExit, match="gap suite: 'x' is no case"):
        script.main(["--numbers", "x"])


def test_rows_are_published_beside_the_page_and_taken_over(
    tmp_path: Path,
    capsys: Any,
    monkeypatch: pytest.MonkeyPatch,
    configuration: dict[str, Any],
) -> None:
    folders, page = write_blind(tmp_path), tmp_path / "docs" / "page.md"
    rows = suite(folders)
    script.main(["--show", "--out", str(folders.out), "--docs", str(page)])
    file, there = page.with_name(script.ROWS), tmp_path / "another machine"
    take = ["--show", "--out", str(there), "--take", str(file)]
    for count in (len(NUMBERS), 0):
        script.main(take)
        assert f"{count} rows taken from" in capsys.readouterr().err
    assert script.stored(NUMBERS, script.store_in(there)) == rows
    lines = file.read_text().splitlines()
    file.write_text("\n".join([*lines[:2], lines[2][:40], *lines[3:]]))
    with pytest.raises(SystemExit, match="line 3 is no row"):
        script.main(take)
    file.write_text("not a file of rows")
    with pytest.raises(SystemExit, match="no file of rows"):
        script.main(take)
    file.write_text("\n".join(lines))
    monkeypatch.setattr(script, "configuration", lambda *tool: {**configuration, "tool": "another"})
    with pytest.raises(SystemExit, match="other code made the rows"):
        script.main(["--show", "--out", str(tmp_path / "third"), "--take", str(file)])


def changed(line: str, *, grade: dict[str, Any] | None = None, **values: Any) -> str:
    row = json.loads(line)
    return json.dumps({**row, **values, "grade": {**row["grade"], **(grade or {})}})


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"grade": {"seconds": "soon"}}, "row.grade.seconds: float is needed, not 'soon'"),
        ({"grade": {"right": "yes"}}, "row.grade.right: bool is needed"),
        ({"grade": {"truth": [["rust", "joint1"]]}}, "the suite hides no 'rust'"),
        ({"times": None}, "row.times: a mapping is needed"),
        ({"number": 9000}, "there is no case 9000"),
        ({"number": 1}, "the line has others"),
        ({"role": "pair"}, "the line has others"),
    ],
)
def test_of_a_file_with_a_broken_row_none_is_taken(
    tmp_path: Path, change: dict[str, Any], complaint: str
) -> None:
    folders, page = write_blind(tmp_path), tmp_path / "page.md"
    suite(folders)
    script.main(["--show", "--out", str(folders.out), "--docs", str(page)])
    file, there = page.with_name(script.ROWS), tmp_path / "another machine"
    lines = file.read_text().splitlines()
    file.write_text("\n".join([*lines[:-1], changed(lines[-1], **change)]))
    with pytest.raises(SystemExit, match=f"line {len(lines)} is no row: .*{re.escape(complaint)}"):
        script.main(["--show", "--out", str(there), "--take", str(file)])
    assert script.stored(NUMBERS, script.store_in(there)) == []


def test_a_whole_run_goes_to_the_docs_and_a_part_does_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folders, page = write_blind(tmp_path), tmp_path / "docs" / "gap_suite.md"
    monkeypatch.setattr(script, "DOCS", page)
    monkeypatch.setattr(script, "full_list", lambda: NUMBERS)
    monkeypatch.setattr(script, "quick_list", lambda: NUMBERS[:2])
    show = ["--show", "--out", str(folders.out)]
    suite(folders, numbers=NUMBERS[:3])
    script.main(show)  # cut short
    script.main([*show, "--quick"])
    script.main([*show, "--numbers", "0-1"])
    assert not page.exists()
    suite(folders)
    script.main(show)
    assert "5 cases" in page.read_text()
    assert "| 11\N{NO-BREAK SPACE}payload |" in page.read_text()


def test_a_case_from_its_drawing_to_its_marks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cases, "SHORT", 1.0)  # s; the tool and all else are the real ones
    folders = Folders(out=tmp_path / "out", blind=tmp_path / "blind")
    (row,) = run_case(shard_for(1), folders=folders, tool=run_tool)
    assert row["error"] == ""
    marks = grade_of(row)
    assert marks.role == "none" and marks.verdict in ("no_gap", "named", "unexplained")
    assert 0.5 < marks.gap_after <= marks.gap_before
    result = read_result(folders.results(row["case"]))
    assert len(result.held_out_runs) == 1
    assert np.isnan(marks.exported)  # nothing was added
    assert not (folders.recordings / row["case"]).exists()


def test_the_gap_of_the_written_model_goes_into_the_row(tmp_path: Path) -> None:
    folders = write_blind(tmp_path, [1000])

    def with_model(recording: Path, folder: Path, tolerance: float = 0.03) -> None:
        stub(recording, folder)
        (folder / EXPORTED).write_text(json.dumps({"exported": 1.5, "fit": 1.2}))

    (row,) = run_case(shard_for(1000), folders=folders, tool=with_model)
    assert grade_of(row).exported == pytest.approx(1.25)
    assert "1.250, 1.250 (1 cases)" in script.report([row], 1)
    assert "1.250, 1.250 (1 cases)" in script.tables([row], 1).replace("\N{NO-BREAK SPACE}", " ")


def test_the_published_rows_are_those_of_the_code_on_record() -> None:
    head = json.loads((script.DOCS.parent / script.ROWS).read_text("utf-8").partition("\n")[0])
    record = json.loads((Path(script.__file__).parent / "code_hashes.json").read_text("utf-8"))
    assert record["published"] == {key: head["configuration"][key] for key in ("tool", "suite")}
    for each in record["equivalent"]:
        assert each["because"] and {len(each["tool"]), len(each["suite"])} == {16}
