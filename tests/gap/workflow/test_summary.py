"""From a finished comparison to the model and the result that are written."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from loose_env.errors import InvalidData
from loose_env.gap import NextMotionSettings
from loose_env.gap.output.checkpoints import Stages, key_of
from loose_env.gap.output.result import DeletionTest, EffectLocation, NamedEffect, read_result
from loose_env.gap.workflow import summary
from loose_env.gap.workflow.evidence import ResidualDiagnostics, diagnose_residuals
from loose_env.gap.workflow.pipeline import GapSolution
from loose_env.gap.workflow.summary import result_of, write_gap
from loose_env.recording import Recording
from tests.gap.cases.gap_case import DAMPING, GAIN, record, solution_for


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


def test_unexplained_says_where_what_is_left_lives(
    solution: GapSolution, evidence: ResidualDiagnostics
) -> None:
    halfway = replace(solution, verdict="unexplained", effects=())
    said = result_of(halfway, evidence).location_words
    assert not any("joint2 has a residual torque" in words for words in said)


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


def test_stages_of_another_version_are_made_again(
    recording: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    keys = {key_of(recording, {}), key_of(recording, {})}
    monkeypatch.setattr("mujoco.__version__", "0.0.1")
    keys.add(key_of(recording, {}))
    monkeypatch.setattr("loose_env.gap.output.checkpoints.version", lambda _: "0.0.1")
    keys.add(key_of(recording, {}))
    assert len(keys) == 3


def test_a_stage_cut_short_or_of_other_data_is_made_again(tmp_path: Path) -> None:
    Stages(tmp_path, "a")("fit", lambda: {"x": np.arange(3)})
    file = next(tmp_path.iterdir())
    assert Stages(tmp_path, "b")("fit", lambda: 5) == 5
    file.write_bytes(file.read_bytes()[:40])
    assert Stages(tmp_path, "b")("fit", lambda: [1.5, None, "a", float("inf")])[3] == np.inf
    assert Stages(tmp_path, "b")("fit", lambda: 0) == [1.5, None, "a", float("inf")]
    assert [path.name for path in tmp_path.iterdir()] == [file.name]


def test_a_motion_that_cannot_be_written_costs_no_result(
    solution: GapSolution, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object, **__: object) -> None:
        raise InvalidData("no motion fits the machine")

    monkeypatch.setattr(summary, "diagnose_residuals", lambda *_, **__: ResidualDiagnostics())
    monkeypatch.setattr(summary, "choose_next", refused)
    (tmp_path / "next_motion.json").write_text("of an earlier run")
    result, written = write_gap(tmp_path, solution, next_motion=NextMotionSettings())
    assert result.warnings[-1] == "no next motion: no motion fits the machine"
    assert read_result(tmp_path).warnings == result.warnings
    assert [path.name for path in written] == ["model.xml", "result.json"]
    assert not (tmp_path / "next_motion.json").exists()
