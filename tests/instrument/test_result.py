"""The format of a diagnosis, and the settings of plan and diagnosis with what they refuse."""

from __future__ import annotations

import dataclasses
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from loose_env.errors import InvalidData, InvalidSetting
from loose_env.instrument import (
    DiagnoseSettings,
    Diagnosis,
    Fault,
    Loop,
    ModelSettings,
    MotionSettings,
    NextMeasurement,
    NextSettings,
    PlanSettings,
    RecordSeen,
    TrendSettings,
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


def test_files_of_earlier_and_later_versions_and_missing_numbers_are_read() -> None:
    found = diagnosis()
    assert found.posterior[found.fault.hypothesis] == found.probability
    plain = json.loads(replace(found, settled=True).to_json())
    assert Diagnosis.from_json(json.dumps(plain)).settled
    del plain["settled"]
    assert Diagnosis.from_json(json.dumps(plain | {"colour": "blue"})) == found
    read = Diagnosis.from_json(json.dumps(plain | {"probability": None}))
    assert math.isnan(read.probability)
    assert json.loads(read.to_json())["probability"] is None


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


# ------------------------------------------------------------------------- settings

KINDS: tuple[Any, ...] = (
    NextSettings,
    DiagnoseSettings,
    TrendSettings,
    MotionSettings,
    PlanSettings,
    ModelSettings,
)


@pytest.mark.parametrize("kind", KINDS)
def test_no_field_takes_a_value_of_another_type_or_a_number_that_is_none(kind: Any) -> None:
    for each in dataclasses.fields(kind):
        for wrong in ({}, object(), "no such", [None], True, np.array(["a"]), 10**400):
            if wrong == "no such" and each.name in ("tool", "joint", "package_path"):
                continue
            if (wrong is True and each.type == "bool") or (
                wrong == 10**400 and not isinstance(each.default, float)
            ):
                continue
            with pytest.raises(InvalidSetting, match=each.name):
                kind(**{each.name: wrong})
        if isinstance(each.default, float):
            for wrong in (float("nan"), float("inf")):
                with pytest.raises(InvalidSetting, match=each.name):
                    kind(**{each.name: wrong})


@pytest.mark.parametrize(
    ("kind", "given", "words"),
    [
        (DiagnoseSettings, {"healthy_prior": 1.0}, "healthy_prior is a probability"),
        (DiagnoseSettings, {"sure": 0.999}, r"sure is at most 0\.995"),
        (DiagnoseSettings, {"inertial_parameters": -0.1}, "is a standard deviation"),
        (NextSettings, {"seconds": 0.0}, "seconds is a length"),
        (NextSettings, {"poses": 2.5}, "poses is a whole number"),
        (NextSettings, {"most_tool": -1.0}, "most_tool is a positive number"),
        (NextSettings, {"torque_share": 2.0}, "torque_share is above 0"),
        (NextSettings, {"band_low": 50.0, "band_high": 20.0}, "a band goes upwards"),
        (NextSettings, {"seconds": 600.0, "rate_hz": 1e5}, "more than 5000000 samples"),
        (NextSettings, {"rate_hz": 250.0, "band_high": 140.0},
         r"band_high is at most 0\.4 of the rate, 100 Hz"),
        (MotionSettings, {"max_speed_rad_s": (0.0,)}, "max_speed_rad_s is one positive number"),
        (MotionSettings, {"max_jerk_rad_s3": (float("nan"),)}, "max_jerk_rad_s3"),
        (MotionSettings, {"command_bandwidth_hz": -1.0}, "command_bandwidth_hz is above 0"),
        (MotionSettings, {"commands": "force"}, "commands is"),
        (MotionSettings, {"signal_format": ("csv", "mat")}, "csv, parquet, ros2, got csv mat"),
        (MotionSettings, {"signal_format": ()}, "got none"),
        (PlanSettings, {"force_n": 0.0}, "force_n is above 0"),
        (ModelSettings, {"payload_kg": -1.0}, "zero or more kg"),
    ],
)  # fmt: skip
def test_settings_that_make_no_sense_are_refused(
    kind: Any, given: dict[str, Any], words: str
) -> None:
    with pytest.raises(InvalidSetting, match=words):
        kind(**given)


def test_numbers_of_numpy_and_whole_ones_are_numbers() -> None:
    taken = NextSettings(seconds=np.float32(2.0), most_tool=2)  # type: ignore[arg-type]
    assert (taken.seconds, taken.most_tool) == (2.0, 2)
