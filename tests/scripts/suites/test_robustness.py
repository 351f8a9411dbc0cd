"""Generated arms and recordings end with a result or one clear line, within their memory."""

from __future__ import annotations

import os
import warnings
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings

from scripts.suites.robustness import (
    COMMANDS,
    MOST_BYTES,
    Case,
    case_of,
    cases,
    main,
    make_run,
    run_case,
    tried,
)

few = settings(
    max_examples=int(os.environ.get("LOOSE_ROBUSTNESS_EXAMPLES", "4")),
    deadline=None,
    derandomize=True,
    suppress_health_check=list(HealthCheck),
)


@pytest.mark.slow
@few
@given(case=cases(("doctor", "inspect", "plan")))
def test_commands_on_anything_end_with_a_result_or_one_line(case: Case, tmp_path_factory) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        outcome, words = run_case(case, tmp_path_factory.mktemp("case"))
    assert outcome in ("result", "refused"), f"{case.words}\n{words}"


@pytest.mark.slow
@pytest.mark.parametrize("number", [1009, 1019, 1027])
def test_spectra_with_few_lines_are_no_traceback(number: int, tmp_path: Path) -> None:
    case = case_of(number, ("gap", "doctor", "diagnose"))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        outcome, words = run_case(case, tmp_path / "case")
    assert outcome in ("result", "refused"), words


def test_a_number_is_the_same_case_each_time() -> None:
    first, again = (case_of(7, COMMANDS) for _ in range(2))
    assert first == again != case_of(8, COMMANDS)
    recorded = next(c for k in range(9) if (c := case_of(k, ("gap",))).arm.ending == "xml")
    model = mujoco.MjModel.from_xml_string(recorded.arm.text)
    runs = [make_run(model, recorded.runs[0], 0) for _ in range(2)]
    np.testing.assert_array_equal(runs[0]["time"], runs[1]["time"])


def test_a_case_is_measured_in_a_process_of_its_own() -> None:
    found = tried(case_of(1, ("doctor",)), seconds=60)
    assert found["outcome"] in ("result", "refused") and found["seconds"] > 0
    assert 0 < found["peak_mb"] * 1024**2 < MOST_BYTES
    assert tried(case_of(2, ("gap",)), seconds=0.0)["outcome"] == "late"


def test_the_suite_writes_its_rows(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    given = ["--examples", "1", "--commands", "inspect", "--out", str(tmp_path)]
    main(given)
    assert "| `loose inspect` | 1 |" in capsys.readouterr().out
    assert (tmp_path / "rows.jsonl").read_text().count("\n") == 1
