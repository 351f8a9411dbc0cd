"""Sets in place of an answer: what stood in for others goes, and they come together."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from loose_env.gap.fitting.gauss_newton import Fit, fit
from loose_env.gap.fitting.holdout_score import Scorer
from loose_env.gap.fitting.model_structure import ModelStructure, nuisance_of
from loose_env.gap.fitting.refit import with_last, with_new_jacobian
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.effects.catalogue import CATALOGUE
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.model.parameter import free_of
from loose_env.gap.selection import revision
from loose_env.gap.selection.revision import SwapStep
from loose_env.gap.selection.screening.relinearised_sets import AlternativeSet, alternative_sets
from loose_env.gap.selection.screening.screening import screen
from loose_env.gap.settings import SearchSettings
from tests.gap.cases.effect_arms import PLANAR
from tests.gap.cases.recorded_runs import compared, measurable, torque_run

MACHINE = NominalModel(measurable(mujoco.MjSpec.from_string(PLANAR)))
LOAD, SPRING = CATALOGUE["payload"](MACHINE, "tool", "centre"), CATALOGUE["joint_spring"](
    MACHINE, "joint2"
)  # fmt: skip
SHIFTS = [CATALOGUE["link_com"](MACHINE, f"link{k}") for k in (2, 3)]
FRICTION = CATALOGUE["viscous_friction"](MACHINE, "joint1")
TRUTH = {LOAD.key, SPRING.key, FRICTION.key}


def fitted_to(
    scorer: Scorer, structure: ModelStructure, start: list[tuple[Effect, list[float]]]
) -> Fit:
    structure = structure.with_effects([effect for effect, _ in start])
    own = [free_of(effect.parameters, np.array(values)) for effect, values in start]
    free = np.concatenate([structure.nominal_start, *own])
    return with_new_jacobian(fit(scorer.comparison, structure, free), scorer.comparison)


@pytest.fixture(scope="module")
def runs() -> tuple[Scorer, ModelStructure]:
    """Torques of an arm with a load beside its tool, a spring, and friction."""
    spec = MACHINE.fresh()
    LOAD.edit(spec, np.array([0.5, 0.06, 0.04, 0.0]))
    SPRING.edit(spec, np.array([6.0, 0.4]))
    FRICTION.edit(spec, np.array([0.8]))
    truth = spec.compile()
    made = [torque_run(MACHINE, truth, np.random.default_rng(k), duration=6.0) for k in range(3)]
    searched, held = compared(MACHINE, made[:2]), compared(MACHINE, made[2:])
    return Scorer(searched, held), ModelStructure(nuisance=nuisance_of(searched, tolerance=0.01))


@pytest.fixture(scope="module")
def answer(runs: tuple[Scorer, ModelStructure]) -> Fit:
    """Two shifts of centres in place of load and spring."""
    stand_ins: list[tuple[Effect, list[float]]] = [(each, [0.02, 0.01]) for each in SHIFTS]
    return fitted_to(*runs, [(FRICTION, [0.5]), *stand_ins])


def test_what_was_stood_in_for_is_proposed_together(
    runs: tuple[Scorer, ModelStructure], answer: Fit
) -> None:
    comparison = runs[0].comparison
    screened = screen(comparison, answer, [LOAD, SPRING])
    first = alternative_sets(comparison, answer, screened, 1)[0]
    assert {effect.key for effect in first.effects} >= TRUTH
    values = dict(zip((effect.kind for effect in first.effects), first.values, strict=True))
    assert values["viscous_friction"][0] == pytest.approx(0.8, rel=0.2)


def test_nothing_is_proposed_in_place_of_the_truth(runs: tuple[Scorer, ModelStructure]) -> None:
    right = fitted_to(
        *runs, [(FRICTION, [0.8]), (LOAD, [0.5, 0.06, 0.04, 0.0]), (SPRING, [6.0, 0.4])]
    )
    screened = screen(runs[0].comparison, right, SHIFTS)
    assert alternative_sets(runs[0].comparison, right, screened, 3) == []


def test_an_answer_of_stand_ins_is_left_for_the_set(
    runs: tuple[Scorer, ModelStructure], answer: Fit
) -> None:
    scorer, nominal = runs
    base = scorer.score(fitted_to(scorer, nominal, []))
    several = [LOAD, SPRING, *SHIFTS, FRICTION]
    swap = SwapStep(scorer.comparison, scorer.comparison, scorer, several, base, SearchSettings())
    better = swap.improved(scorer.score(answer))
    assert {effect.key for effect in better.fitted.effects} == TRUTH
    assert better.held_out_rms < 1.1


def test_the_same_effects_once_more_are_no_other_set(
    runs: tuple[Scorer, ModelStructure], answer: Fit, monkeypatch: pytest.MonkeyPatch
) -> None:
    scorer, nominal = runs
    base, best = scorer.score(fitted_to(scorer, nominal, [])), scorer.score(answer)
    values = tuple(tuple(own.tolist()) for own in answer.hypothesis.values)
    same = AlternativeSet(effects=answer.effects, values=values)
    monkeypatch.setattr(revision, "alternative_sets", lambda *_: [same])
    monkeypatch.setattr(revision, "fit", lambda *_, **__: pytest.fail("fitted once more"))
    swap = SwapStep(
        scorer.comparison, scorer.comparison, scorer, [LOAD, SPRING], base, SearchSettings()
    )
    assert swap._another_set(best) is None


def test_shares_of_axes_are_those_that_combine_to_the_values() -> None:
    for effect, values in ((LOAD, [0.7, 0.02, -0.03, 0.01]), (SHIFTS[0], [0.01, -0.02])):
        shares = effect.shares_of(np.array(values))
        assert effect.combined(shares) == pytest.approx(values)
    assert LOAD.combined(np.array([-1.0, 0.0, 0.0, 0.0])) == LOAD.null_values


def test_an_effect_listed_last_keeps_its_numbers(answer: Fit) -> None:
    moved = with_last(answer, answer.effects[0])
    assert moved.effects == (*answer.effects[1:], answer.effects[0])
    assert moved.free[-1] == answer.free[answer.structure.slices[0].start]
    assert np.array_equal(
        moved.jacobian[:, -1], answer.jacobian[:, answer.structure.slices[0].start]
    )
