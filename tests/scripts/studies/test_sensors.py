"""The study of sensors scores what it should, and writes all that it is made of."""

from __future__ import annotations

import importlib
import json
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from loose_env.arms import planar


@pytest.fixture(scope="module")
def study() -> ModuleType:
    return importlib.import_module("scripts.studies.sensors")


def test_the_smallest_gap_lies_where_the_rising_share_crosses(study: ModuleType) -> None:
    gaps = 1e3 * np.array(study.GAPS)
    share = np.zeros(len(gaps))
    share[4:] = 1.0
    assert study.smallest_gap(share, 0.5) == pytest.approx(np.sqrt(gaps[3] * gaps[4]))
    assert study.smallest_gap(0.4 * share, 0.5) is None
    assert study.smallest_gap(np.ones(len(gaps)), 0.5) == pytest.approx(gaps[0])
    # A dip below what smaller gaps reach is averaged out, not taken for a limit.
    dipped = share.copy()
    dipped[5] = 0.9
    assert study.smallest_gap(dipped, 0.9) == pytest.approx(study.smallest_gap(share, 0.9), rel=0.2)


def test_every_set_of_sensors_can_be_read_from_one_record(study: ModuleType) -> None:
    arm = planar(3)
    full = study.rows_of(arm, study.LinkAccelerometers())
    names = []
    for sensors in study.sensor_sets(arm):
        matrix = full.projection(sensors.rows)
        assert matrix.shape == (len(sensors.rows), len(full))
        names.append((sensors.name, sensors.sensors, len(sensors.rows)))
    assert names == [
        ("tool", 1, 2),
        ("tool + link 1", 2, 4),
        ("tool + links 1, 2", 3, 6),
        ("tool + links 1, 2, 3", 4, 8),
        ("tool + all links, tangential", 4, 5),
        ("all links, tangential, no tool", 3, 3),
    ]


def test_a_small_study_writes_its_rows_settings_and_picture(
    study: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("matplotlib")
    out = tmp_path / "picture.png"
    words = ["--arms", "vera", "--cases", "2", "--duration", "0.2", "--gaps", "5e-5", "2e-4"]
    study.main([*words, "--out", str(out)])
    printed = capsys.readouterr().out
    assert "tool + links 1, 2" in printed
    found = json.loads(out.with_suffix(".json").read_text())
    assert found["settings"]["cases"] == 2
    assert len(found["rows"]) == 5 * len(study.REFERENCES)
    for row in found["rows"]:
        assert row["arm"] == "vera"
        assert 0 <= row["link_right"] <= 1
        assert len(row["detected"]) == 2
        if row["found"] > 0:  # of two links
            assert 0.5 <= row["link_said_found"] <= 1
            assert 0 <= row["within_two_sd"] <= 1
    assert out.stat().st_size > 10_000
    assert sorted(path.name for path in tmp_path.iterdir()) == ["picture.json", "picture.png"]
    study.main(["--show", str(out.with_suffix(".json"))])
    assert capsys.readouterr().out.count("tool + links 1, 2") == 1
