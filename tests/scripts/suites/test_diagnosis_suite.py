from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from loose_env.recording import read_recording, write_recording
from scripts.suites.diagnosis.__main__ import marks, table
from scripts.suites.diagnosis.cases import KINDS, draw, random_motion, taken
from scripts.suites.gap.arms import model_xml
from scripts.suites.rows import kept
from tests.instrument.test_result import diagnosis


def test_a_case_is_drawn_by_its_number_and_seed_alone() -> None:
    assert [draw(k, 1).kind for k in range(4)] == list(KINDS)
    assert draw(5, 1).hypothesis == draw(5, 1).hypothesis
    assert not np.array_equal(draw(0, 1).sensor, draw(0, 2).sensor)


@pytest.mark.slow
def test_recordings_hold_pose_and_joint_and_nothing_of_the_truth(tmp_path: Path) -> None:
    case = draw(1, 1)
    run = taken(case, random_motion(case, 0, 3), "run-1", case.rng(4, 0), sound=False)
    model = model_xml(case.arm.figures)
    write_recording(tmp_path / case.name, model_xml=model, runs=[run])
    read = read_recording(tmp_path / case.name).runs[0]
    assert read.pose is not None and len(read.excited) == 1
    words = "".join(p.read_text("utf-8") for p in (tmp_path / case.name).glob("*.[jx]*"))
    assert "looseness" not in words and "gap" not in words


def test_the_table_counts_what_was_said() -> None:
    row = marks(draw(1, 1), diagnosis()) | {"steps": [dict(diagnosis().posterior)], "shown": 0.2}
    healthy = row | {"kind": "healthy", "true": "healthy", "said": "healthy"}
    words = table([row, healthy], "two cases")
    assert "healthy called healthy: 1 of 1" in words
    assert "structural_looseness: kind and location: 0 of 1" in words
    assert "    kind: 1 of 1" in words


def test_probabilities_after_each_run_are_graded_by_themselves() -> None:
    row = marks(draw(1, 1), diagnosis()) | {"shown": 0.2}
    first, last = {"healthy": 0.75, row["true"]: 0.25}, {"healthy": 0.0, row["true"]: 1.0}
    words = table([row | {"steps": [first, last]}], "one case")
    assert "after 1 run(s): 0 of 1 (0%); of faults 0 of 1 (0%); calibration error 0.750" in words
    assert "after 2 run(s): 1 of 1 (100%); of faults 1 of 1 (100%); calibration error 0" in words


def test_a_row_that_was_cut_off_is_left_out(tmp_path: Path) -> None:
    file = tmp_path / "rows.jsonl"
    file.write_text('{"case": 1}\n{"case": 2, "sa')
    assert kept(file) == [{"case": 1}]
