"""What else is missing beside a part that strikes its stops, whose law is not quite the model's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from loose_env.gap.fitting.gauss_newton import Fit
from loose_env.gap.fitting.holdout_score import Scorer, improvement_of
from loose_env.gap.fitting.model_structure import ModelStructure, nuisance_of
from loose_env.gap.fitting.refit import with_new_jacobian
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.effects.catalogue import CATALOGUE, candidates
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.model.parameter import free_of
from loose_env.gap.output.checkpoints import Stages, key_of
from loose_env.gap.residuals.preparation.prepare import GapProblem, prepare
from loose_env.gap.selection.acceptance import Acceptance
from loose_env.gap.selection.checkpoint_codec import StepFiles
from loose_env.gap.selection.forward_selection import Selection
from loose_env.gap.selection.revision import SwapStep
from loose_env.gap.selection.reweighted_search import SearchResult, beside_stops, search
from loose_env.gap.settings import GapSettings, SearchSettings
from loose_env.gap.workflow.pipeline import GapSolution, find_gap
from loose_env.recording import Recording, write_recording
from loose_env.typing import Array
from tests.gap.cases.gap_case import nominal_structure
from tests.gap.cases.level_arm import FINE, LEVEL, moving

NOTHING = Hypothesis()
KINDS = ("backlash", "actuator_gain")
COUNT = 2000
GAP, GAIN = 0.01, 0.9


def with_play(folder: Path) -> Recording:
    """Runs of an arm with backlash between stops of another law, and a motor that is weak."""
    spec = mujoco.MjSpec.from_string(LEVEL)
    spec.option.timestep = FINE
    machine = NominalModel(mujoco.MjSpec.from_string(LEVEL), step=FINE)
    play = CATALOGUE["backlash"](machine, "joint2")
    play.edit(spec, np.array([GAP, 4e3, 0.15]))
    added = spec.joints[2]
    assert added.name == "joint2_backlash"
    added.solimp_limit[4] = 1.5  # force grows with travel by another power than on the model's
    servo = spec.actuator("servo1")
    servo.gainprm[0] *= GAIN
    servo.biasprm[1:3] *= GAIN
    speeds = [np.array([7.0 + k, 11.0 - 2 * k, 16.0 + k]) for k in range(3)]
    runs = moving(spec.compile(), speeds, size=0.3, count=COUNT)
    return write_recording(folder, model_xml=LEVEL, runs=runs)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return with_play(tmp_path_factory.mktemp("play") / "r")


@pytest.fixture(scope="module")
def problem(recording: Recording) -> GapProblem:
    return prepare(recording, GapSettings(threads=1))


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("stages")


@pytest.fixture(scope="module")
def whole(recording: Recording, kept: Path) -> tuple[GapSolution, list[str]]:
    lines: list[str] = []
    stages, settings = Stages(kept, key_of(recording, {})), GapSettings(threads=1, kinds=KINDS)
    return find_gap(recording, settings, say=lines.append, stages=stages), lines


def test_what_is_left_in_channels_is_their_root_mean_square(problem: GapProblem) -> None:
    runs = problem.search
    wanted = np.arange(1.0, 1.0 + len(runs.channels))
    residual = wanted[runs.rows.channel] * np.where(np.arange(len(runs)) % 2, 1.0, -1.0)
    assert np.allclose(runs.channel_rms(residual), wanted)


def test_louder_noise_makes_residuals_as_much_smaller(problem: GapProblem) -> None:
    factors = np.linspace(1.0, 5.0, len(problem.search.channels))
    scaled = problem.with_noise_scaled(factors)
    for name in ("search", "fit", "held_out", "held_out_whole"):
        one, other = getattr(problem, name), getattr(scaled, name)
        before, after = (runs.residuals([NOTHING])[0] for runs in (one, other))
        assert np.allclose(after * factors[one.rows.channel], before)
    # what was the same runs stays so, or all of them would be fitted once more
    assert (scaled.fit is scaled.search) == (problem.fit is problem.search)
    assert (scaled.held_out is scaled.held_out_whole) == (
        problem.held_out is problem.held_out_whole
    )


def test_what_was_found_in_louder_noise_is_told_in_the_noise_there_is(problem: GapProblem) -> None:
    scaled = problem.with_noise_scaled(np.full(len(problem.search.channels), 4.0))
    friction = CATALOGUE["viscous_friction"](problem.machine, "joint1")
    structure = nominal_structure(problem.machine).plus(friction)
    free = np.append(structure.nominal_start, free_of(friction.parameters, [0.5]))
    rng = np.random.default_rng(1)

    def scored(runs: GapProblem) -> Any:
        residual = np.zeros(len(runs.fit))
        jacobian = rng.normal(size=(len(runs.fit), len(free)))
        fitted = Fit(structure=structure, free=free, residual=residual, jacobian=jacobian, cost=0.0)
        residual = runs.fit.residuals([fitted.hypothesis])[0]
        return Scorer(runs.fit, runs.held_out_whole).score(replace(fitted, residual=residual))

    first, second = scored(problem), scored(scaled)
    base = Selection(base=first)
    parts = ((problem, base), (scaled, Selection(base=second)))
    found = SearchResult(problem=problem, parts=parts)
    told = found.rescored(second)
    assert np.allclose(told.fitted.residual, 4 * second.fitted.residual)
    assert np.allclose(told.fitted.jacobian, 4 * second.fitted.jacobian)
    assert told.held_out_rms == pytest.approx(first.held_out_rms)
    same = SearchResult(problem=problem, parts=parts[:1])
    assert same.rescored(first) is first


def test_a_weak_motor_is_found_beside_play_of_another_law(
    whole: tuple[GapSolution, list[str]],
) -> None:
    found, lines = whole
    assert found.verdict == "named"
    assert {(e.kind, e.where) for e in found.effects} == {
        ("backlash", "joint2"),
        ("actuator_gain", "servo1"),
    }
    own = {e.kind: e for e in found.effects}
    assert own["backlash"].parameters["gap"] == pytest.approx(GAP, rel=0.05)
    low, high = own["actuator_gain"].interval_95["gain"]
    assert 0.8 < low < GAIN < high < 1.0
    assert any("reweighting: the residual of the stops counts as noise" in line for line in lines)
    # told in the noise there is, of which stops leave several times as much
    assert found.base.held_out_rms > 1.5 * found.best.held_out_rms > 4


def test_noise_is_worked_out_anew_with_each_effect(
    recording: Recording, kept: Path, whole: tuple[GapSolution, list[str]]
) -> None:
    found, lines = whole
    assert any("reweighting: the residual of the stops counts as noise" in line for line in lines)
    # by its own noise the last part leaves about that much, for it is what it left before
    problem, machine = found.problem, found.problem.machine
    nuisance = nuisance_of(problem.search, tolerance=problem.settings.tolerance)
    stages = Stages(kept, key_of(recording, {}))
    last = search(
        problem,
        nuisance,
        candidates(machine, KINDS),
        settings=SearchSettings(most_effects=problem.settings.most_effects),
        keep=partial(StepFiles, stages, machine, nuisance),
    ).selection
    assert stages.taken_up[-1].startswith("part-2-")  # the same search, not another one
    assert last.base.held_out_rms < 0.5 * found.base.held_out_rms
    assert 0.5 < last.best.held_out_rms < 1.5


def test_steps_of_both_searches_are_listed_one_after_the_other(
    whole: tuple[GapSolution, list[str]],
) -> None:
    found, _ = whole
    steps = [each.step for each in found.ranking]
    assert steps == sorted(steps) and set(steps) >= {1, 2}
    first = {each.step: each for each in reversed(found.ranking)}
    assert (first[1].kind, first[2].kind) == ("backlash", "actuator_gain")
    # in the noise there is; by that of its own part it leaves about one
    assert first[2].held_out == pytest.approx(found.best.held_out_rms, rel=0.3)


def test_an_interrupted_second_search_goes_on_where_it_was(
    recording: Recording, kept: Path, whole: tuple[GapSolution, list[str]]
) -> None:
    names = {file.stem for file in kept.iterdir()}
    first = ["nominal", "effect-1", "part-2-begun"]
    assert names > {*first, "part-2-effect-1"}
    for name in names - set(first):
        (kept / f"{name}.npz").unlink()
    stages = Stages(kept, key_of(recording, {}))
    again = find_gap(recording, GapSettings(threads=1, kinds=KINDS), stages=stages)
    assert stages.taken_up == first
    assert again.effects == whole[0].effects and again.ranking == whole[0].ranking


def test_what_play_beside_it_does_alone_is_no_second_effect(problem: GapProblem) -> None:
    runs, machine = problem.search, problem.machine
    nominal = nominal_structure(machine)
    play = CATALOGUE["backlash"](machine, "joint2")
    friction = CATALOGUE["viscous_friction"](machine, "joint3")
    off, right = (np.array([gap, 1.0, 0.3]) for gap in (0.6 * GAP, GAP))
    stiffness = play.parameters[1].scale
    off[1], right[1] = stiffness, stiffness
    scorer = Scorer(runs, problem.held_out)

    def scored(values: Array, *, beside: bool) -> Any:
        structure = nominal.plus(*((play, friction) if beside else (play,)))
        free = np.concatenate(
            [
                nominal.nominal_start,
                free_of(play.parameters, values),
                free_of(friction.parameters, np.array([1e-4])) if beside else [],
            ]
        )
        fitted = Fit(
            structure=structure, free=free, residual=np.zeros(len(runs)),
            jacobian=np.zeros((len(runs), len(free))), cost=0.0,
        )  # fmt: skip
        residual = runs.residuals([fitted.hypothesis])[0]
        return scorer.score(with_new_jacobian(replace(fitted, residual=residual), runs))

    before, later = scored(off, beside=False), scored(right, beside=True)
    acceptance = Acceptance(runs, scorer, before, before, SearchSettings())
    assert acceptance.significant(improvement_of(later, before))
    assert not acceptance.needed_beside_stops(later)
    assert acceptance.objection(later) == "not needed beside the part with stops"


def test_a_part_with_stops_is_not_exchanged_in_noise_that_it_makes(
    problem: GapProblem, monkeypatch: pytest.MonkeyPatch
) -> None:
    runs, machine = problem.search, problem.machine
    effects = [CATALOGUE["backlash"](machine, "joint2"), CATALOGUE["payload"](machine, "tool")]
    free = np.concatenate([free_of(e.parameters, np.array(e.starts[0])) for e in effects])
    fitted = Fit(
        structure=ModelStructure(effects=tuple(effects)), free=free, residual=np.zeros(len(runs)),
        jacobian=np.zeros((len(runs), len(free))), cost=0.0,
    )  # fmt: skip
    scorer, tried = Scorer(runs, problem.held_out), list[str]()
    best = scorer.score(fitted)

    def noted(_: SwapStep, effects: Sequence[Effect], *_others: object) -> None:
        tried.extend(effect.kind for effect in effects)

    monkeypatch.setattr(SwapStep, "_in_place_of", noted)
    for settings in (SearchSettings(), beside_stops(SearchSettings())):
        assert SwapStep(runs, runs, scorer, effects, best, settings).improved(best) is best
    assert tried == ["backlash", "payload", "payload"]
