"""Calibration of `loose gap` on cases of its suite: what is taken, fitted and judged."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from loose_env.errors import InvalidSetting
from loose_env.gap import PROBABILITY_FEATURES, DeletionTest, Gap, GapResult, NamedEffect
from scripts.suites.gap.studies.calibrate import (
    EVIDENCE,
    CaseEvidence,
    add_evidence,
    fitted,
    judged_text,
    left_out,
    main,
    read_evidence,
    taken,
)

TEST = DeletionTest(
    held_out_z=5.0, training_z=7.0, share_of_error=0.6, share_without=0.9, share_in_channel=0.85
)


def _run(path: Path, numbers: range) -> Path:
    """A finished run of the suite: clear effects are right, weak ones are not."""
    rng = np.random.default_rng(3)
    for folder in ("rows", "blind/truth"):
        (path / folder).mkdir(parents=True)
    for number in numbers:
        clear = number % 4 < 2
        z, share = (rng.uniform(6, 9), 0.98) if clear else (rng.uniform(2, 3.4), 0.6)
        mass = 1.0 + 0.1 * rng.standard_normal()
        effect = NamedEffect(
            kind="payload",
            where="tool",
            parameters={"mass": mass},
            interval_95={"mass": (mass - 0.1, mass + 0.1)},
            deletion=replace(TEST, held_out_z=z, share_without=share, share_in_channel=share),
        )
        result = GapResult(verdict="named", gap=Gap(before=6.0, after=1.0), effects=(effect,))
        name = f"case-{number}"
        result.write(path / "results" / name / "result.json")
        kind, where = ("payload", "tool") if clear else ("base_tilt", "base")
        truth = {"effects": [{"kind": kind, "where": where, "parameters": {"mass": 1.0}}]}
        (path / f"blind/truth/{name}.json").write_text(json.dumps(truth))
        row = {
            "case": name,
            "number": number,
            "role": "single",
            "error": "",
            "grade": {"right": clear},
        }
        (path / "rows" / f"shard-{number}.json").write_text(json.dumps({"rows": [row]}))
    return path


def test_evidence_is_kept_once_a_case(tmp_path: Path) -> None:
    cases = taken(_run(tmp_path / "run", range(1000, 1008)))
    file = tmp_path / "evidence.jsonl"
    assert add_evidence(cases, file) == 8 == add_evidence(cases, file)
    assert read_evidence(file) == sorted(cases, key=lambda case: case.number)
    assert [c.effects[0].right for c in cases] == [True, True, False, False] * 2
    assert all(len(c.effects[0].main) == c.effects[0].right for c in cases)


def test_each_case_is_judged_by_what_is_fitted_to_the_others(tmp_path: Path) -> None:
    cases = taken(_run(tmp_path, range(1000, 1080)))
    found = fitted(cases)
    assert (found.effects, found.right, found.sizes) == (80, 40, 40)
    for weight, (_, sign) in zip(found.weights, PROBABILITY_FEATURES, strict=True):
        assert weight * sign >= 0
    # half widths of one standard deviation: about twice that holds 95 %
    assert 1.5 < found.size_factor < 3.0
    judged = left_out(cases)
    held = judged.scores <= judged.factors
    assert held.mean() >= 0.9 > (judged.scores <= 1.0).mean()
    text = judged_text(judged, len(cases), found)
    assert "80 effects of 80 cases" in text
    error = float(text.split("calibration error ")[1].split()[0])
    assert error < 0.1


def test_cases_without_parameters_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidSetting, match="no parameters"):
        fitted(taken(_run(tmp_path, range(1002, 1004))))


def test_a_run_whose_truths_are_elsewhere_is_refused(tmp_path: Path) -> None:
    run = _run(tmp_path, range(1000, 1002))
    (run / "blind/truth/case-1001.json").unlink()
    with pytest.raises(InvalidSetting, match=r"truth of case-1001 is not there.*--blind"):
        taken(run)


def test_an_unfinished_run_is_refused_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match="no finished cases"):
        main(["--take", str(tmp_path), "--evidence", str(tmp_path / "file")])
    assert not (tmp_path / "file").exists()


def test_the_cases_of_the_docs_are_read() -> None:
    cases = read_evidence(EVIDENCE)
    assert len({case.number for case in cases}) == len(cases) > 0
    assert all(isinstance(case, CaseEvidence) for case in cases)
