"""Probabilities of effects: which way they go, and how their map is made and judged."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from loose_env.errors import InvalidSetting
from loose_env.gap import DeletionTest, Gap, GapResult, NamedEffect
from loose_env.gap.output.probability import (
    PROBABILITY_FEATURES,
    probability_features,
    probability_of,
)
from scripts.suites.gap import calibrate

TEST = DeletionTest(
    held_out_z=5.0, training_z=7.0, share_of_error=0.6, share_without=0.9, share_in_channel=0.85
)
GAP = Gap(before=6.0, after=1.5)


def test_better_evidence_never_makes_an_effect_less_probable() -> None:
    own = probability_of(TEST, rivals=1, gap=GAP)
    assert 0.01 <= own <= 0.99
    for better in (
        replace(TEST, held_out_z=9.0),
        replace(TEST, share_without=0.99),
        replace(TEST, share_in_channel=0.99),
    ):
        assert probability_of(better, rivals=1, gap=GAP) >= own
    assert probability_of(TEST, rivals=0, gap=GAP) >= own
    assert probability_of(TEST, rivals=5, gap=GAP) <= own
    assert probability_of(TEST, rivals=1, gap=Gap(before=6.0, after=1.0)) >= own


def test_features_stay_finite_at_the_ends() -> None:
    for share, z in ((0.0, -3.0), (1.0, 400.0), (-2.0, 0.0)):
        test = replace(TEST, held_out_z=z, share_without=share, share_in_channel=share)
        for gap in (Gap(before=1.0, after=1.0), Gap(before=0.9, after=0.8), GAP):
            assert np.isfinite(probability_features(test, rivals=0, gap=gap)).all()


def _folder(path: Path, cases: int) -> Path:
    """Finished cases as the suite stores them: clear effects are right, weak ones are not."""
    rng = np.random.default_rng(3)
    (path / "rows").mkdir(parents=True)
    for number in range(cases):
        clear = number % 2 == 0
        z, share = (rng.uniform(6, 9), 0.98) if clear else (rng.uniform(2, 3.4), 0.6)
        test = replace(TEST, held_out_z=z, share_without=share, share_in_channel=share)
        effect = NamedEffect(kind="payload", where="tool", parameters={"mass": 1.0}, deletion=test)
        result = GapResult(verdict="named", gap=GAP, effects=(effect,))
        result.write(path / "results" / f"case-{number}" / "result.json")
        truth = [["payload", "tool"]] if clear else [["base_tilt", "base"]]
        row = {
            "case": f"case-{number}",
            "error": "",
            "grade": {"truth": truth, "right": clear},
        }
        (path / "rows" / f"shard-{number}.json").write_text(json.dumps({"rows": [row]}))
    return path


def test_a_map_of_one_folder_is_calibrated_on_another(tmp_path: Path) -> None:
    first, second = (_folder(tmp_path / name, 40) for name in ("a", "b"))
    judged = calibrate.read_cases([first])
    assert judged.features.shape == (40, len(PROBABILITY_FEATURES)) and judged.right.sum() == 20
    found = calibrate.fitted_map(judged)
    for weight, (_, sign) in zip(found.weights, PROBABILITY_FEATURES, strict=True):
        assert weight * sign >= 0
    others = calibrate.read_cases([second])
    likely = found.probability(others.features)
    assert likely[others.right == 1].min() > 0.8 > 0.2 > likely[others.right == 0].max()
    table = calibrate.calibration_table(others, likely)
    assert "40 effects" in table and "calibration error" in table


def test_a_folder_without_cases_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidSetting, match="no finished cases"):
        calibrate.read_cases([tmp_path])
