"""The result: its format, its probabilities, and how a finished comparison becomes one."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from loose_env.gap.output.calibration import widened_interval, with_probability
from loose_env.gap.output.evidence_schema import (
    Band,
    ChannelResidual,
    JointResidual,
    Location,
    ResidualTest,
)
from loose_env.gap.workflow import summary

from loose_env.errors import InvalidData
from loose_env.gap import (
    DeletionTest,
    Dependence,
    EffectLocation,
    Gap,
    GapCalibration,
    GapResult,
    GapSolution,
    NamedEffect,
    NextMotionSettings,
    RankedHypothesis,
    ResidualDiagnostics,
    Stages,
    diagnose_residuals,
    interval_score,
    key_of,
    read_result,
    result_of,
    write_gap,
)
from loose_env.gap.output.result import UNIT
from loose_env.recording import Recording
from tests.gap.cases.gap_case import DAMPING, GAIN, record, solution_for

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
    with pytest.raises(InvalidData, match="cannot be read"):
        read_result(tmp_path)


TEST = DeletionTest(
    held_out_z=5.0, training_z=7.0, share_of_error=0.6, share_without=0.9, share_in_channel=0.85
)
EFFECT = NamedEffect(kind="payload", where="tool", parameters={"mass": 1.0}, deletion=TEST)
GAP = Gap(before=6.0, after=1.5)
RIVALS = tuple(EffectLocation(kind="link_mass", where=f"link{k}") for k in range(3))
MAP = GapCalibration(
    offset=1.0,
    weights=(1.0, 0.5, 0.5, -1.0),
    mean=(1.5, 2.0, 2.0, 0.3),
    deviation=(0.3, 1.0, 1.0, 0.5),
    effects=100,
    right=80,
    size_factor=1.5,
    shape_factor=2.5,
    sizes=100,
    shapes=50,
)


def _probability(effect: NamedEffect, gap: Gap = GAP) -> float:
    found = with_probability(effect, gap, MAP).probability
    assert found is not None
    return found


def test_better_evidence_makes_an_effect_more_probable() -> None:
    own = _probability(EFFECT)
    for better in (
        replace(TEST, held_out_z=6.5),
        replace(TEST, share_without=0.99),
        replace(TEST, share_in_channel=0.99),
    ):
        assert _probability(replace(EFFECT, deletion=better)) > own
    assert _probability(EFFECT, Gap(before=6.0, after=1.0)) > own


def test_effects_that_cannot_be_told_apart_share_the_probability() -> None:
    alone = _probability(EFFECT)
    among = with_probability(replace(EFFECT, ambiguous_with=RIVALS), GAP, MAP)
    assert among.probability is not None and among.rival_probability is not None
    assert among.probability < alone and among.rival_probability > 0
    assert among.probability + 3 * among.rival_probability == pytest.approx(alone)


def test_a_part_found_by_its_impacts_has_a_probability_too() -> None:
    weak, strong = (
        _probability(replace(EFFECT, deletion=None, impact_power_explained=share))
        for share in (0.3, 0.95)
    )
    assert 0.01 <= weak < strong <= 0.99


@pytest.mark.parametrize(
    ("value", "interval", "truth"),
    [(1.0, (0.8, 1.3), 1.9), (-2.0, (-2.5, -1.9), -1.2), (0.1, (-0.2, 0.3), -0.9)],
)
def test_the_score_is_the_factor_with_which_an_interval_just_holds_the_truth(
    value: float, interval: tuple[float, float], truth: float
) -> None:
    score = interval_score(value, interval, truth)
    for factor, holds in ((score * 1.01, True), (score * 0.99, False)):
        low, high = widened_interval(value, interval, factor)
        assert (low <= truth <= high) is holds


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return record(tmp_path_factory.mktemp("gap") / "recording")


@pytest.fixture(scope="module")
def solution(recording: Recording) -> GapSolution:
    return solution_for(recording)


@pytest.fixture(scope="module")
def evidence(solution: GapSolution) -> ResidualDiagnostics:
    return diagnose_residuals(solution)


def test_the_gap_closes_by_channel_and_by_horizon(
    solution: GapSolution, evidence: ResidualDiagnostics
) -> None:
    gap = result_of(solution, evidence).gap
    assert gap.before > 3 and 0.9 < gap.after < 1.2
    held = solution.problem.held_out_whole
    assert set(gap.by_channel) == {channel.name for channel in held.channels}
    before, after = gap.by_channel["sensor.encoder2"]
    assert before > 3 and 0.8 < after < 1.2
    assert list(gap.by_quantity) == [
        "joint position [rad]",
        "joint speed [rad/s]",
        "acceleration [m/s²]",
    ]
    floor = held.floors[-1]
    own = np.isin(held.rows.channel, [4, 5, 6])
    for given, residual in zip(
        gap.by_quantity["acceleration [m/s²]"],
        (solution.base.held_out_residual, solution.best.held_out_residual),
        strict=True,
    ):
        assert given == pytest.approx(np.sqrt(np.mean(residual[own] ** 2)) * floor, rel=0.1)
    assert list(gap.by_horizon_s) == ["0.1", "0.5", "2.0"]
    assert all(before > 1.5 and 0.9 < after < 1.3 for before, after in gap.by_horizon_s.values())


def test_an_effect_less_probable_than_not_is_doubtful(solution: GapSolution) -> None:
    def tested(effect: NamedEffect, share: float, z: float) -> NamedEffect:
        test = DeletionTest(
            held_out_z=z, training_z=z, share_of_error=share, share_without=share,
            share_in_channel=share,
        )  # fmt: skip
        return replace(effect, deletion=test)

    sure = tested(solution.effects[0], 0.95, 60.0)
    weak = tested(solution.effects[1], 0.02, 2.1)
    result = result_of(replace(solution, effects=(sure, weak)))
    assert [e.kind for e in result.effects] == [sure.kind] and result.verdict == "named"
    assert [e.kind for e in result.doubtful] == [weak.kind]
    assert result.doubtful[0].probability is not None and result.doubtful[0].probability < 0.5
    alone = result_of(replace(solution, effects=(weak,)))
    assert alone.verdict == "unexplained" and not alone.effects
    # of rivals that share the probability one is named
    rivals = tuple(EffectLocation(kind="payload", where=f"link{k}") for k in range(3))
    shared = result_of(replace(solution, effects=(replace(sure, ambiguous_with=rivals),)))
    assert [e.kind for e in shared.effects] == [sure.kind]


def test_the_result_says_where_it_was_and_what_is_left(
    solution: GapSolution, evidence: ResidualDiagnostics
) -> None:
    result = result_of(solution, evidence)
    runs = {gap.run for gap in result.location.channels}
    assert runs == {"run-01.csv", "run-02.csv", "run-03.csv"}
    assert any("joint2" in words for words in result.location_words)
    assert result.held_out_runs == ("run-03.csv",)
    assert len(result.residual_tests) == len(solution.problem.held_out_whole.channels)
    assert all(0.8 < left.rms < 1.3 for left in result.residual_tests)
    assert set(result.nominal_parameters.values()) == {1.0}
    told = [words for words in result.warnings if words.startswith("these motions")]
    assert bool(told) == bool(
        result.identifiability.unidentifiable or result.identifiability.confusable
    )
    assert result.settings["tolerance"] == 0.03


@pytest.fixture
def known(evidence: ResidualDiagnostics, monkeypatch: pytest.MonkeyPatch) -> None:
    """The evidence is worked out once."""
    monkeypatch.setattr(summary, "diagnose_residuals", lambda *_, **__: evidence)


@pytest.mark.usefixtures("known")
def test_what_is_written_reads_back_and_carries_the_effects(
    solution: GapSolution, tmp_path: Path
) -> None:
    result, written = write_gap(tmp_path, solution)
    assert [path.name for path in written] == ["model.xml", "result.json"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["model.xml", "result.json"]
    model = mujoco.MjModel.from_xml_path(str(written[0]))
    nominal = solution.problem.machine.model
    dof = nominal.joint("joint2").dofadr[0]
    assert model.dof_damping[dof] == pytest.approx(nominal.dof_damping[dof] + DAMPING)
    assert "viscous_friction at joint2: damping 3 N·m·s/rad" in written[0].read_text("utf-8")
    assert read_result(tmp_path) == type(result).from_json(result.to_json())
    assert f"data.sensor('rate3').data *= {GAIN}" in json.loads(written[1].read_text())["code"]


@pytest.mark.usefixtures("known")
def test_what_the_corrected_model_has_without_its_being_named_is_told(
    solution: GapSolution, tmp_path: Path
) -> None:
    unnamed = replace(solution, verdict="unexplained", effects=())
    result, (file, _) = write_gap(tmp_path, unnamed)
    assert result.effects == ()
    (told,) = [words for words in result.warnings if "not identified" in words]
    assert "viscous_friction at joint2: damping 3 N·m·s/rad" in told
    assert "sensor_gain at rate3: gain 1.25 (not in model.xml: see result.json, code)" in told
    head = file.read_text("utf-8").split("-->")[0]
    assert "Added to the nominal model, but not identified" in head
    assert "Added to the nominal model:" not in head
    assert "viscous_friction at joint2: damping 3 N·m·s/rad" in head
    nominal, model = solution.problem.machine.model, mujoco.MjModel.from_xml_path(str(file))
    dof = nominal.joint("joint2").dofadr[0]
    assert model.dof_damping[dof] > 1.0 + nominal.dof_damping[dof]


def test_a_stage_cut_short_or_of_other_data_or_versions_is_made_again(
    recording: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    keys = {key_of(recording, {}), key_of(recording, {})}
    monkeypatch.setattr("mujoco.__version__", "0.0.1")
    keys.add(key_of(recording, {}))
    monkeypatch.setattr("loose_env.gap.output.checkpoints.version", lambda _: "0.0.1")
    keys.add(key_of(recording, {}))
    assert len(keys) == 3
    Stages(tmp_path, "a")("fit", lambda: {"x": np.arange(3)})
    file = next(tmp_path.iterdir())
    assert Stages(tmp_path, "b")("fit", lambda: 5) == 5
    file.write_bytes(file.read_bytes()[:40])
    assert Stages(tmp_path, "b")("fit", lambda: [1.5, None, "a", float("inf")])[3] == np.inf
    assert Stages(tmp_path, "b")("fit", lambda: 0) == [1.5, None, "a", float("inf")]
    assert [path.name for path in tmp_path.iterdir()] == [file.name]


@pytest.mark.usefixtures("known")
def test_a_motion_that_cannot_be_written_costs_no_result(
    solution: GapSolution, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object, **__: object) -> None:
        raise InvalidData("no motion fits the machine")

    monkeypatch.setattr(summary, "choose_next", refused)
    (tmp_path / "next_motion.json").write_text("of an earlier run")
    result, written = write_gap(tmp_path, solution, next_motion=NextMotionSettings())
    assert result.warnings[-1] == "no next motion: no motion fits the machine"
    assert read_result(tmp_path).warnings == result.warnings
    assert [path.name for path in written] == ["model.xml", "result.json"]
    assert not (tmp_path / "next_motion.json").exists()
