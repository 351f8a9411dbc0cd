"""The result file: keys and words of the format, what is refused, and what is written with it."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from loose_env.errors import InvalidData
from loose_env.gap import (
    ChannelVerdict,
    EffectLocation,
    FittedEffect,
    Gap,
    GapResult,
    GapSolution,
    Identifiability,
    JointExcitation,
    NamedEffect,
    RankedSet,
    ResidualTest,
    TolerancePull,
    VisibleEffect,
    read_result,
    write_gap,
)
from loose_env.gap.explain import moving_alike, named_effect
from loose_env.gap.model.effects.joints import LoadFriction
from loose_env.gap.output.result import UNIT
from tests.gap.cases.gap_case import record, solution_for

FRICTION = EffectLocation(kind="coulomb_friction", where="joint2")
FITTED = FittedEffect(kind="coulomb_friction", where="joint2", parameters={"torque": 1.32})


def result() -> GapResult:
    return GapResult(
        verdict="named",
        effects=(
            NamedEffect(
                kind="coulomb_friction",
                where="joint2",
                parameters={"torque": 1.32},
                interval_95={"torque": (1.2, 1.44)},
                ambiguous_with=(
                    FittedEffect(kind="backlash", where="joint2", parameters={"gap": 0.01},
                                 units={"gap": "rad"}),
                ),
                units={"torque": "N·m"},
                probability=0.98,
                probability_alone=0.7,
                z=9.0,
                held_out_gain={"run": 30.0, "stretch": 41.0},
            ),
        ),
        gap=Gap(
            before=4.1,
            after=1.1,
            by_channel={"joint2": (4.5, 1.1)},
            by_quantity={"joint torque [N·m]": (1.3, 0.1)},
        ),
        channels=(
            ChannelVerdict(
                channel="joint2", verdict="named", effects=(FRICTION,), before=4.5, after=1.1
            ),
        ),
        pulled=(
            TolerancePull(name="mass of link2", deviations=-2.4, value=-0.12, tolerance=0.05,
                          unit="kg"),
        ),
        held_out_runs=("run-05.parquet",),
        ranking=(RankedSet(effects=(FITTED,), behind=0.0, probability=0.9, source="simulation"),),
        residual_tests=(
            ResidualTest(
                channel="joint2", rms=1.1, autocorrelation=0.1, whiteness_95=0.2,
                largest_autocorrelation=0.1, correlation_time=0.02,
            ),
        ),
        identifiability=Identifiability(
            joints=(
                JointExcitation(
                    joint="joint2", unit="rad", travel=1.0, speed=1.5, acceleration=9.0, used=0.9
                ),
            ),
            effects=(
                VisibleEffect(
                    kind="backlash", where="joint2", smallest={"gap": 0.01}, units={"gap": "rad"},
                    visible=True, confusable_with=FRICTION,
                ),
            ),
        ),
        warnings=("the step is coarse",),
        settings={"threads": 1, "tolerances": {"mass": 0.05}},
        code="data.sensor('x').data *= 2",
    )  # fmt: skip


def test_the_file_has_the_keys_and_words_of_the_format() -> None:
    plain = json.loads(result().to_json())
    assert plain["format"] == "loose-gap/1" and plain["verdict"] == "named"
    effect = plain["effects"][0]
    assert effect["kind"] == "coulomb_friction" and effect["where"] == "joint2"
    assert effect["parameters"] == {"torque": 1.32}
    assert effect["interval_95"] == {"torque": [1.2, 1.44]}
    other = {"kind": "backlash", "where": "joint2", "parameters": {"gap": 0.01}}
    assert effect["ambiguous_with"] == [other | {"units": {"gap": "rad"}}]
    assert (effect["probability"], effect["probability_alone"]) == (0.98, 0.7)
    assert plain["ranking"][0]["source"] == "simulation"
    gap = plain["gap"]
    assert (gap["before"], gap["after"], gap["noise_floor"]) == (4.1, 1.1, 1.0)
    assert gap["unit"] == UNIT == "RMS over held-out data, in noise standard deviations"
    assert gap["by_quantity"] == {"joint torque [N·m]": [1.3, 0.1]}
    assert plain["held_out_runs"] == ["run-05.parquet"] and plain["model"] == "model.xml"
    assert plain["channels"][0]["verdict"] == "named"
    pull = {"name": "mass of link2", "deviations": -2.4, "value": -0.12, "tolerance": 0.05}
    assert plain["pulled"] == [pull | {"unit": "kg"}]
    assert list(plain)[:3] == ["format", "verdict", "gap"]


def test_a_result_reads_back_as_it_was(tmp_path: Path) -> None:
    file = result().write(tmp_path / "new" / "result.json")
    assert read_result(file) == result() == read_result(tmp_path / "new")
    assert [path.name for path in file.parent.iterdir()] == ["result.json"]


def test_numbers_that_are_not_finite_are_null_and_later_keys_are_left_out() -> None:
    text = GapResult(verdict="no_gap", gap=Gap(before=math.inf, after=math.nan)).to_json()
    assert json.loads(text)["gap"]["before"] is None
    assert math.isnan(GapResult.from_json(text).gap.after)
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
def test_what_is_no_result_is_refused_with_its_place(
    change: dict[str, object], words: str, tmp_path: Path
) -> None:
    plain = json.loads(result().to_json()) | change
    with pytest.raises(InvalidData, match=words):
        GapResult.from_json(json.dumps(plain))
    with pytest.raises(InvalidData, match="no JSON"):
        GapResult.from_json("{")
    with pytest.raises(InvalidData, match="there is no result"):
        read_result(tmp_path)


@pytest.fixture(scope="module")
def solution(tmp_path_factory: pytest.TempPathFactory) -> GapSolution:
    return solution_for(record(tmp_path_factory.mktemp("result") / "recording"))


def test_what_is_written_reads_back_and_carries_the_effects(
    solution: GapSolution, tmp_path: Path
) -> None:
    (tmp_path / "result.json").write_text("of an earlier run")
    written = write_gap(tmp_path, solution)
    assert [path.name for path in written] == ["model.xml", "result.json"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["model.xml", "result.json"]
    (friction,) = solution.result.effects
    model = mujoco.MjModel.from_xml_path(str(written[0]))
    assert model.dof_frictionloss[1] == pytest.approx(friction.parameters["torque"], rel=1e-4)
    assert "coulomb_friction at elbow: torque " in written[0].read_text("utf-8").split("-->")[0]
    found = read_result(tmp_path)
    assert found == GapResult.from_json(solution.result.to_json())
    assert found.settings["kinds"] == list(solution.answer.settings.kinds)
    best, *others = found.ranking
    assert best.source == "force balance"
    assert best.behind == 0.0 and all(other.behind >= 0.0 for other in others)
    assert set(found.gap.by_channel) == {each.channel for each in found.channels}
    assert best.effects[0].parameters == pytest.approx(friction.parameters, rel=0.05)


def test_a_parameter_without_a_value_is_told(solution: GapSolution) -> None:
    (found,) = (f for f in solution.answer.decision.findings if f.named)
    machine = solution.answer.selection.evidence.balance.machine
    effect = LoadFriction(machine, "elbow", "stribeck")
    rough = replace(
        found, term=replace(found.term, effect=effect), values=np.array([0.5, 1.1, 0.2]),
        low=np.array([0.4, 0.8, 0.01]), high=np.array([0.6, 1.3, 0.3]),
    )  # fmt: skip
    told = named_effect(rough)
    assert told.undetermined == ("static_ratio", "speed")  # no peak; a factor of thirty
    assert told.value_in_words("speed") == "not determined (0.01 to 0.3) rad/s"
    assert "run" not in named_effect(replace(found, by_run=5.0, by_stretch=5.0)).held_out_gain


def test_joints_whose_residuals_move_together_are_told(solution: GapSolution) -> None:
    answer = solution.answer
    count = len(answer.selection.evidence.balance.channels)
    open_ = tuple(replace(c, verdict="unexplained") for c in answer.decision.channels)
    open_answer = replace(answer, decision=replace(answer.decision, channels=open_))
    one, other = np.random.default_rng(1).normal(
        size=(2, len(answer.selection.evidence.balance.drive), 1)
    )
    alike = moving_alike(open_answer, np.tile(one, (1, count)))
    assert "moves with that of elbow (correlation 0." in alike["shoulder"]
    apart = np.where(np.arange(count) == 0, one, other)
    assert moving_alike(open_answer, apart) == {}
