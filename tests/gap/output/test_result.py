from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from loose_env.errors import InvalidData
from loose_env.gap.output.evidence_schema import (
    Band,
    ChannelResidual,
    Dependence,
    JointResidual,
    Location,
    ResidualTest,
)
from loose_env.gap.output.result import (
    UNIT,
    EffectLocation,
    Gap,
    GapResult,
    NamedEffect,
    RankedHypothesis,
    read_result,
)

GOES = Dependence(regressor="direction", joint="joint2", share=0.8, explained=3.2, z=9.0)


def result() -> GapResult:
    return GapResult(
        verdict="named",
        effects=(
            NamedEffect(
                kind="coulomb_friction",
                where="joint2",
                parameters={"torque": 1.32},
                interval_95={"torque": (1.2, 1.44)},
                ambiguous_with=(EffectLocation(kind="backlash", where="joint2"),),
                units={"torque": "N·m"},
            ),
        ),
        gap=Gap(
            before=4.1,
            after=1.1,
            by_channel={"sensor.joint2_pos": (4.5, 1.1)},
            by_horizon_s={"0.1": (1.5, 1.0), "0.5": (3.0, 1.1), "2.0": (4.0, 1.2)},
        ),
        held_out_runs=("run-05.parquet",),
        ranking=(
            RankedHypothesis(kind="coulomb_friction", where="joint2", held_out=1.2, bic=-310.0),
        ),
        location=Location(
            channels=(
                ChannelResidual(
                    run="run-01.parquet",
                    channel="sensor.joint2_pos",
                    rms=4.5,
                    offset=0.1,
                    bands=(Band(low=0.0, high=1.0, rms=9.0, share=0.7),),
                    dependences=(GOES,),
                ),
            ),
            joints=(
                JointResidual(
                    run="run-01.parquet", joint="joint2", unit="N·m", residual=1.3, noise=0.1,
                    load=9.0,
                    dependences=(GOES,),
                ),
            ),
        ),
        residual_tests=(
            ResidualTest(
                channel="sensor.joint2_pos", rms=1.1, autocorrelation=0.1,
                whiteness_95=0.05, largest_autocorrelation=0.1, correlation_time=0.002, trend=0.1,
                trend_z=0.5, dependences=(),
            ),
        ),
        nominal_parameters={"mass.link1": 1.01},
        warnings=("the step is coarse",),
        settings={"tolerance": 0.03, "naming": {"most": 3}},
        code="data.sensor('x').data *= 2",
    )  # fmt: skip


def test_the_file_has_the_keys_and_words_of_the_format() -> None:
    plain = json.loads(result().to_json())
    assert plain["format"] == "loose-gap/1" and plain["verdict"] == "named"
    effect = plain["effects"][0]
    assert effect["kind"] == "coulomb_friction" and effect["where"] == "joint2"
    assert effect["parameters"] == {"torque": 1.32}
    assert effect["interval_95"] == {"torque": [1.2, 1.44]}
    assert effect["ambiguous_with"] == [{"kind": "backlash", "where": "joint2"}]
    gap = plain["gap"]
    assert (gap["before"], gap["after"], gap["noise_floor"]) == (4.1, 1.1, 1.0)
    assert gap["unit"] == UNIT == "RMS over held-out runs, in noise standard deviations"
    assert gap["by_horizon_s"] == {"0.1": [1.5, 1.0], "0.5": [3.0, 1.1], "2.0": [4.0, 1.2]}
    assert plain["held_out_runs"] == ["run-05.parquet"] and plain["model"] == "model.xml"
    ranked = plain["ranking"][0]
    assert {k: ranked[k] for k in ("kind", "where", "held_out", "bic")} == {
        "kind": "coulomb_friction", "where": "joint2", "held_out": 1.2, "bic": -310.0,
    }  # fmt: skip
    assert list(plain)[:3] == ["format", "verdict", "gap"]


def test_a_result_reads_back_as_it_was(tmp_path: Path) -> None:
    file = result().write(tmp_path / "new" / "result.json")
    assert read_result(file) == result() == read_result(tmp_path / "new")
    assert [path.name for path in file.parent.iterdir()] == ["result.json"]


def test_numbers_that_are_not_finite_are_null_and_come_back_as_nan() -> None:
    text = GapResult(verdict="no_gap", gap=Gap(before=math.inf, after=math.nan)).to_json()
    assert json.loads(text)["gap"]["before"] is None
    assert math.isnan(GapResult.from_json(text).gap.after)


def test_keys_of_a_later_version_are_left_out() -> None:
    plain = json.loads(result().to_json()) | {"colour": "blue"}
    assert GapResult.from_json(json.dumps(plain)) == result()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"format": "loose-gap/9"}, "loose-gap/9"),
        ({"verdict": "perhaps"}, "perhaps"),
        ({"gap": {"before": 1.0}}, "'after' is missing"),
        ({"gap": 3}, "a mapping is needed"),
        ({"warnings": "none"}, "a list is needed"),
        ({"effects": [{"kind": "a", "where": "b", "parameters": {"x": "1"}}]}, "float is needed"),
        ({"effects": [{"kind": 3, "where": "b", "parameters": {}}]}, r"effects\[0\].kind: str"),
    ],
)
def test_what_is_no_result_is_refused_with_its_place(change: dict[str, object], words: str) -> None:
    plain = json.loads(result().to_json()) | change
    with pytest.raises(InvalidData, match=words):
        GapResult.from_json(json.dumps(plain))


def test_text_and_files_that_are_no_json_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidData, match="no JSON"):
        GapResult.from_json("{")
    with pytest.raises(InvalidData, match="cannot be read"):
        read_result(tmp_path)
