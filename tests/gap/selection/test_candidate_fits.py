"""What stood in for an effect goes when that effect is there; what is needed beside it stays."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from loose_env.gap.data.aligned_run import align_run, channels_of
from loose_env.gap.data.noise_floor import noise_floor
from loose_env.gap.fitting.gauss_newton import FitSettings, fit
from loose_env.gap.fitting.holdout_score import ScoredFit, Scorer, improvement_of
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.effects.catalogue import CATALOGUE, candidates
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.model.parameter import free_of, values_of
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.gap.selection.acceptance import Acceptance
from loose_env.gap.selection.candidate_fits import CandidateFits
from loose_env.gap.selection.revision import SwapStep
from loose_env.gap.settings import CONFIRMED_Z, SearchSettings
from tests.gap.cases.gap_case import DAMPING, GAIN, STEP, nominal_structure, record


class Case:
    """Runs of an arm that lacks viscous friction at joint2; its sensor rate3 shows too much."""

    def __init__(self, folder: Path) -> None:
        recording = record(folder)
        self.machine = NominalModel(recording.spec(), step=STEP)
        channels = channels_of(list(recording.runs))
        trials = [align_run(run, self.machine, channels, step=STEP) for run in recording.runs]
        floors = np.array([noise_floor(trials[0].measured[:, c]) for c in range(len(channels))])
        self.comparison = ResidualModel(self.machine, trials[:-1], channels, floors, threads=1)
        self.scorer = Scorer(
            self.comparison, ResidualModel(self.machine, trials[-1:], channels, floors, threads=1)
        )
        self.nominal = nominal_structure(self.machine)
        self.effects: dict[tuple[str, str], Effect] = {}
        self.fits: dict[tuple[tuple[Effect, tuple[float, ...]], ...], ScoredFit] = {}

    def fitted(self, named: list[tuple[Effect, list[float]]]) -> ScoredFit:
        """Fit effects from these values on; a fit that several tests begin with is made once."""
        key = tuple((e, tuple(v)) for e, v in named)
        if key not in self.fits:
            own = [free_of(e.parameters, np.array(v)) for e, v in named]
            start = np.concatenate([self.nominal.nominal_start, *own])
            structure = self.nominal.with_effects([e for e, _ in named])
            self.fits[key] = self.scorer.score(fit(self.comparison, structure, start))
        return self.fits[key]

    def effect(self, kind: str, where: str, values: list[float]) -> tuple[Effect, list[float]]:
        if (kind, where) not in self.effects:
            self.effects[kind, where] = CATALOGUE[kind](self.machine, where)
        return self.effects[kind, where], values

    def alone(self, base: ScoredFit, earlier: ScoredFit, both: ScoredFit) -> ScoredFit | None:
        candidate_fits = CandidateFits(self.comparison, self.comparison, self.scorer, earlier)
        return candidate_fits.without_earlier(both, base.fitted)


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Case:
    return Case(tmp_path_factory.mktemp("trying") / "recording")


def test_a_stand_in_is_not_needed_beside_what_it_stood_for(case: Case) -> None:
    gain = case.effect("sensor_gain", "rate3", [GAIN])
    dry = case.effect("coulomb_friction", "joint2", [1.0])
    wet = case.effect("viscous_friction", "joint2", [DAMPING])
    both = case.fitted([gain, dry, wet])
    alone = case.alone(case.fitted([gain]), case.fitted([gain, dry]), both)
    assert alone is not None
    assert [e.kind for e in alone.fitted.effects] == ["sensor_gain", "viscous_friction"]
    improvement = improvement_of(both, alone)
    assert min(improvement.held_out, improvement.training) < CONFIRMED_Z


def test_of_two_effects_neither_does_alone(case: Case) -> None:
    gain = case.effect("sensor_gain", "rate3", [GAIN])
    wet = case.effect("viscous_friction", "joint2", [DAMPING])
    base, both = case.fitted([]), case.fitted([gain, wet])
    assert case.alone(base, case.fitted([gain]), both) is None
    assert case.alone(base, case.fitted([wet]), case.fitted([wet, gain])) is None


def test_what_made_an_effect_idle_may_be_the_one_too_many(case: Case) -> None:
    """The new friction at joint2 took over; without it the old one and the other new one do."""
    wet = case.effect("viscous_friction", "joint2", [DAMPING])
    dry = case.effect("coulomb_friction", "joint2", [1.5])
    gain = case.effect("sensor_gain", "rate3", [GAIN])
    base, before = case.fitted([]), case.fitted([wet])
    together = before.fitted.structure.plus(dry[0], gain[0])
    own = together.slices[0]
    new = [free_of(effect.parameters, np.array(values)) for effect, values in (dry, gain)]
    free = np.concatenate([before.fitted.free, *new])
    free[own] = free_of(wet[0].parameters, np.array([0.1]))
    as_is = FitSettings(iterations=0)
    stuck = case.scorer.score(fit(case.comparison, together, free, settings=as_is))
    acceptance = Acceptance(case.comparison, case.scorer, base, before, SearchSettings())
    rather = acceptance.earlier_form(stuck, wet[0])
    assert rather is not None
    assert [e.kind for e in rather.fitted.effects] == ["viscous_friction", "sensor_gain"]
    assert rather.total < 0.5 * stuck.total
    kept = values_of(wet[0].parameters, rather.fitted.free[own])
    assert kept[0] == pytest.approx(DAMPING, rel=0.1)
    assert (
        acceptance.earlier_form(case.fitted([wet, gain]), wet[0]) is None
    )  # nothing new at its joint


def test_a_last_trace_is_not_named_however_sure_it_is(case: Case) -> None:
    wet = case.effect("viscous_friction", "joint2", [DAMPING])
    gain = case.effect("sensor_gain", "rate3", [GAIN])
    bias = case.effect("sensor_bias", "rate3", [0.001])
    base, before = case.fitted([]), case.fitted([wet, gain])
    # all that hangs together is explained, and in every block of time a little less is left
    part, whole = (
        replace(
            case.fitted([wet, gain, bias]),
            held_out_blocks=before.held_out_blocks * (1 - less),
            training_blocks=before.training_blocks * (1 - less),
            held_out_products=0.0 * before.held_out_products,
            training_products=0.0 * before.training_products,
        )
        for less in (1e-3, 0.1)
    )
    acceptance = Acceptance(case.comparison, case.scorer, base, before, SearchSettings())
    assert all(acceptance.significant(improvement_of(each, before)) for each in (part, whole))
    assert acceptance.accepts(whole)
    assert not acceptance.accepts(part)


def exchange(case: Case, base: ScoredFit, best: ScoredFit) -> ScoredFit:
    kinds = ("viscous_friction", "quadratic_drag", "actuator_gain", "actuator_lag")
    given = candidates(case.machine, kinds)
    tried = SwapStep(case.comparison, case.comparison, case.scorer, given, base, SearchSettings())
    return tried.improved(best)


def test_what_was_named_for_a_mixture_is_exchanged_when_the_other_is_there(case: Case) -> None:
    gain = case.effect("sensor_gain", "rate3", [GAIN])
    drag = case.effect("quadratic_drag", "joint2", [1.0])
    base, mistaken = case.fitted([]), case.fitted([drag, gain])
    found = exchange(case, base, mistaken)
    assert [e.kind for e in found.fitted.effects] == ["sensor_gain", "viscous_friction"]
    assert found.fitted.effects[-1].where == "joint2"
    assert found.total < mistaken.total


def test_two_that_stood_in_for_one_go_together(case: Case) -> None:
    gain = case.effect("sensor_gain", "rate3", [GAIN])
    drag = case.effect("quadratic_drag", "joint2", [1.0])
    soft = case.effect("actuator_gain", "servo2", [0.9])
    found = exchange(case, case.fitted([]), case.fitted([drag, soft, gain]))
    assert [e.kind for e in found.fitted.effects] == ["sensor_gain", "viscous_friction"]


def test_what_is_right_stays(case: Case) -> None:
    gain = case.effect("sensor_gain", "rate3", [GAIN])
    wet = case.effect("viscous_friction", "joint2", [DAMPING])
    best = case.fitted([wet, gain])
    assert exchange(case, case.fitted([]), best) is best
