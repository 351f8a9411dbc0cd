"""Sets of effects from one linearised problem: an arm with friction and a wrong sensor."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from loose_env.gap import GapSettings
from loose_env.gap.data.aligned_run import align_run, channels_of
from loose_env.gap.data.noise_floor import noise_floor
from loose_env.gap.fitting.gauss_newton import fit
from loose_env.gap.fitting.model_structure import ModelStructure, nuisance_of
from loose_env.gap.model.effects.catalogue import candidates
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.residuals.preparation.prepare import prepare
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.gap.selection.screening.joint_proposals import JointProblem, Proposal
from loose_env.gap.selection.screening.screening import ScreenedCandidate, screen
from loose_env.gap.selection.screening.window_fits import WindowFits
from loose_env.recording import write_recording
from tests.gap.cases.effect_arms import PLANAR
from tests.gap.cases.gap_case import STEP, nominal_structure, record
from tests.gap.cases.recorded_runs import measurable, torque_run

KINDS = ("viscous_friction", "quadratic_drag", "coulomb_friction", "sensor_gain", "actuator_gain")
TRUTH = {("viscous_friction", "joint2"), ("sensor_gain", "rate3")}


class Case:
    """Runs of an arm that lacks viscous friction at joint2; its sensor rate3 shows too much."""

    def __init__(self, folder: Path) -> None:
        recording = record(folder)
        machine = NominalModel(recording.spec(), step=STEP)
        channels = channels_of(list(recording.runs))
        trials = [align_run(run, machine, channels, step=STEP) for run in recording.runs]
        floors = np.array([noise_floor(trials[0].measured[:, c]) for c in range(len(channels))])
        self.comparison = ResidualModel(machine, trials, channels, floors, threads=1)
        nominal = nominal_structure(machine)
        self.windows = WindowFits(
            self.comparison, fit(self.comparison, nominal, nominal.nominal_start)
        )
        self.screened = screen(self.comparison, self.windows.before, candidates(machine, KINDS))

    def problem(self, screened: list[ScreenedCandidate] | None = None) -> JointProblem:
        chosen = self.screened if screened is None else screened
        return JointProblem(self.comparison, self.windows.before, chosen)


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Case:
    return Case(tmp_path_factory.mktemp("joint") / "recording")


def places(proposal: Proposal) -> set[tuple[str, str]]:
    return {(each.effect.kind, each.effect.where) for each in proposal.members}


def test_the_true_pair_is_proposed_first(case: Case) -> None:
    first, *others = case.problem().pairs(4)
    assert places(first) == TRUTH
    assert first.predicted > 0.5
    assert all(other.predicted <= first.predicted for other in others)
    assert len({frozenset(places(each)) for each in (first, *others)}) == len(others) + 1


def test_a_pair_is_of_two_effects_and_not_of_two_variants(case: Case) -> None:
    for each in case.problem().pairs(20):
        assert len(places(each)) == 2


def test_a_greedy_set_ends_where_no_further_effect_is_worth_it(case: Case) -> None:
    first, *_ = case.problem().greedy()
    assert places(first) == TRUTH


def test_friction_at_every_joint_is_proposed_as_such(tmp_path: Path) -> None:
    """Beside effects that are richer than friction, with a gap and a stiffness of their own."""
    spec = measurable(mujoco.MjSpec.from_string(PLANAR))
    machine = NominalModel(spec.copy())
    dry, viscous = np.array([6.0, 4.0, 2.0]), np.array([4.0, 3.0, 1.5])
    runs = [
        torque_run(
            machine,
            spec.compile(),
            np.random.default_rng(seed),
            rate=100.0,
            friction=lambda speed: dry * np.tanh(speed / 0.01) + viscous * speed,
            name=f"run-{seed}",
        )
        for seed in range(2)
    ]
    recording = write_recording(tmp_path / "arm", model_xml=spec.to_xml(), runs=runs)
    kinds = ("viscous_friction", "coulomb_friction", "backlash", "load_friction", "torque_ripple")
    problem = prepare(recording, GapSettings(kinds=kinds, threads=1))
    nominal = ModelStructure(nuisance=nuisance_of(problem.fit, tolerance=0.03))
    windows = WindowFits(problem.fit, fit(problem.fit, nominal, nominal.nominal_start))
    screened = screen(problem.fit, windows.before, problem.sought)
    *_, many = JointProblem(problem.fit, windows.before, screened).greedy()
    assert places(many) == {
        (kind, f"joint{j}") for kind in ("viscous_friction", "coulomb_friction") for j in (1, 2, 3)
    }


def test_a_kind_is_proposed_at_all_of_its_places(case: Case) -> None:
    found = case.problem().kinds(3)
    assert len(found) == len({each.members[0].effect.kind for each in found})
    for each in found:
        assert len({member.effect.kind for member in each.members}) == 1
        assert len({member.effect.where for member in each.members}) == len(each.members) > 1


def test_no_more_of_a_signature_is_taken_than_is_believed(case: Case) -> None:
    pinned = [replace(each, shares=(0.0, 0.25)) for each in case.screened]
    free, bound = case.problem().pairs(1)[0], case.problem(pinned).pairs(1)[0]
    assert bound.predicted < free.predicted
    by_key = {each.effect.key: each for each in case.screened}
    for member in bound.members:
        whole = np.array(by_key[member.effect.key].values)
        none = np.array(member.effect.null_values)
        assert np.all(np.abs(np.array(member.values) - none) <= 0.26 * np.abs(whole - none))


def test_one_candidate_makes_no_set(case: Case) -> None:
    first = case.screened[0]
    twins = [first, replace(first, predicted=0.5)]  # two starts of one effect
    for chosen in ([], [first], twins):
        problem = case.problem(chosen)
        assert problem.pairs(4) == problem.kinds(4) == []
        assert problem.greedy() == []


def test_a_race_leaves_the_best_and_drops_what_is_far_behind(case: Case) -> None:
    pair = case.problem().pairs(1)[0]
    sets = [*([each] for each in case.screened[:6]), pair.members]
    left, best = case.windows.staged_fits(sets)
    assert best is not None
    assert {(e.kind, e.where) for e in best.effects} == TRUTH
    assert [each.cost for each in left] == sorted(each.cost for each in left)
    assert len(left) < len(sets)
    assert case.windows.residual_share(best) < 0.05
    assert case.windows.residual_share(case.windows.before) == pytest.approx(1.0)
