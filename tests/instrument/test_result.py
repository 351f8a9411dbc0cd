from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest

from loose_env.errors import InvalidData
from loose_env.instrument.result import (
    Diagnosis,
    Fault,
    Loop,
    NextMeasurement,
    RecordSeen,
    read_diagnosis,
)


def diagnosis() -> Diagnosis:
    posterior = {"healthy": 0.05, "structural_looseness@forearm": 0.9, "backlash@elbow": 0.05}
    return Diagnosis(
        fault=Fault(
            kind="structural_looseness", where="forearm", direction=(0.0, 0.6, 0.8),
            direction_half_angle_deg=4.0, gap_m=1.2e-4, gap_interval_m=(0.8e-4, 1.8e-4),
        ),
        probability=0.9,
        posterior=posterior,
        next=NextMeasurement(
            pose={"shoulder": 0.1, "elbow": -0.5}, joints=("elbow",), band_hz=(30.0, 150.0),
            levels=(9.0,), torques=(2.5,), seconds=2.0, rate_hz=1000.0, gain=0.3,
            reason="the forearm and the elbow look alike so far",
        ),
        warnings=("the encoder is coarse",),
        records=(
            RecordSeen(
                file="run-01.parquet", pose={"shoulder": 0.1, "elbow": 0.7}, excited=("shoulder",),
                condition="suspect", probabilities=posterior, direction_tool=(1.0, 0.0, 0.0),
                half_angle_deg=6.0,
                loops=(
                    Loop(joint="shoulder", plane="xy", angle_deg=(0.0, 90.0),
                         correlation=(0.9, 0.1), expected=(0.95, 0.0)),
                ),
                notes=("short",),
            ),
        ),
        settings={"seed": 0},
    )  # fmt: skip


def test_the_file_has_the_keys_of_the_format() -> None:
    plain = json.loads(diagnosis().to_json())
    assert list(plain)[:7] == [
        "format", "fault", "probability", "posterior", "next", "warnings", "records",
    ]  # fmt: skip
    assert plain["format"] == "loose-diagnosis/1"
    assert {k: plain["fault"][k] for k in ("kind", "where", "direction", "gap_m")} == {
        "kind": "structural_looseness", "where": "forearm", "direction": [0.0, 0.6, 0.8],
        "gap_m": 1.2e-4,
    }  # fmt: skip
    assert plain["posterior"]["structural_looseness@forearm"] == 0.9
    assert plain["next"]["joints"] == ["elbow"] and plain["next"]["band_hz"] == [30.0, 150.0]


def test_a_diagnosis_reads_back_as_it_was(tmp_path: Path) -> None:
    file = diagnosis().write(tmp_path / "new" / "result.json")
    assert read_diagnosis(file) == diagnosis() == read_diagnosis(tmp_path / "new")
    assert [path.name for path in file.parent.iterdir()] == ["result.json"]


def test_the_fault_is_a_key_of_the_posterior() -> None:
    found = diagnosis()
    assert found.posterior[found.fault.hypothesis] == found.probability
    assert Fault(kind="healthy").hypothesis == "healthy"


def test_whether_it_is_settled_is_kept_and_not_known_of_older_files() -> None:
    plain = json.loads(replace(diagnosis(), settled=True).to_json())
    assert Diagnosis.from_json(json.dumps(plain)).settled
    del plain["settled"]
    assert not Diagnosis.from_json(json.dumps(plain)).settled


def test_numbers_that_are_not_finite_are_null() -> None:
    plain = json.loads(diagnosis().to_json())
    plain["probability"] = None
    read = Diagnosis.from_json(json.dumps(plain))
    assert math.isnan(read.probability)
    assert json.loads(read.to_json())["probability"] is None


def test_keys_of_a_later_version_are_left_out() -> None:
    plain = json.loads(diagnosis().to_json()) | {"colour": "blue"}
    assert Diagnosis.from_json(json.dumps(plain)) == diagnosis()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"format": "loose-diagnosis/9"}, "loose-diagnosis/9"),
        ({"fault": {"kind": "rust"}}, "rust"),
        ({"fault": {"kind": "backlash"}}, "needs the name of a location"),
        ({"fault": {"kind": "backlash", "where": "wrist"}}, "does not have the fault"),
        ({"fault": {"kind": "healthy", "where": "elbow"}}, "has no location"),
        (
            {"fault": {"kind": "structural_looseness", "where": "a", "direction": [1, 1, 0]}},
            "unit vector",
        ),
        ({"fault": 3}, "a mapping is needed"),
        ({"posterior": {"healthy": 0.5}}, "sum 1"),
        ({"posterior": {}}, "sum 1"),
        ({"posterior": {"healthy": None}}, "sum 1"),
        ({"warnings": "none"}, "a list is needed"),
        ({"next": {"pose": {}}}, "'joints' is missing"),
    ],
)
def test_what_is_no_diagnosis_is_refused(change: dict[str, object], words: str) -> None:
    plain = json.loads(diagnosis().to_json()) | change
    with pytest.raises(InvalidData, match=words):
        Diagnosis.from_json(json.dumps(plain))


def test_text_and_files_that_are_no_json_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidData, match="no JSON"):
        Diagnosis.from_json("{")
    with pytest.raises(InvalidData, match="no JSON"):
        Diagnosis.from_json("[" * 100000)
    with pytest.raises(InvalidData, match="cannot be read"):
        read_diagnosis(tmp_path)
