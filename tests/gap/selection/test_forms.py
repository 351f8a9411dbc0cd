"""An effect takes another form where that explains what others beside it stood in for."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from loose_env.gap.fitting.gauss_newton import fit
from loose_env.gap.fitting.holdout_score import ScoredFit, Scorer
from loose_env.gap.fitting.model_structure import ModelStructure, nuisance_of
from loose_env.gap.fitting.refit import fit_in_form
from loose_env.gap.model.effects.catalogue import CATALOGUE
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.model.parameter import free_of, values_of
from loose_env.gap.selection.revision import SwapStep
from loose_env.gap.settings import SearchSettings
from tests.gap.cases.effect_arms import PLANAR
from tests.gap.cases.recorded_runs import compared, measurable, torque_run

MACHINE = NominalModel(measurable(mujoco.MjSpec.from_string(PLANAR)))
POINT = CATALOGUE["payload"](MACHINE, "tool", "")
CENTRE = CATALOGUE["payload"](MACHINE, "tool", "centre")
MASS, FIGURE, FRICTION = (
    CATALOGUE[kind](MACHINE, where)
    for kind, where in (
        ("link_mass", "link3"), ("link_com", "link3"), ("viscous_friction", "joint1"),
    )
)  # fmt: skip
LOAD = np.array([0.5, 0.06, 0.04, 0.0])


def loaded() -> tuple[Scorer, ModelStructure]:
    """Torques of an arm with a load beside its tool and friction at its first joint."""
    spec = MACHINE.fresh()
    CENTRE.edit(spec, LOAD)
    FRICTION.edit(spec, np.array([0.8]))
    truth = spec.compile()
    runs = [torque_run(MACHINE, truth, np.random.default_rng(k), duration=6.0) for k in range(3)]
    searched, held = compared(MACHINE, runs[:2]), compared(MACHINE, runs[2:])
    return Scorer(searched, held), ModelStructure(nuisance=nuisance_of(searched, tolerance=0.01))


def score(scorer: Scorer, structure: ModelStructure, values: list[list[float]]) -> ScoredFit:
    own = [
        free_of(e.parameters, np.array(v)) for e, v in zip(structure.effects, values, strict=True)
    ]
    start = np.concatenate([structure.nominal_start, *own])
    return scorer.score(fit(scorer.comparison, structure, start))


def test_a_load_beside_the_tool_takes_the_place_of_what_stood_in_for_it() -> None:
    scorer, nominal = loaded()
    base = score(scorer, nominal, [])
    several = [MASS, POINT, CENTRE]
    swap = SwapStep(scorer.comparison, scorer.comparison, scorer, several, base, SearchSettings())
    for stand_ins, starts in (
        ((POINT, FIGURE), [[0.4], [0.01, 0.0]]),
        ((MASS, FIGURE), [[0.4], [0.05, 0.0]]),
    ):
        answer = score(scorer, nominal.with_effects([FRICTION, *stand_ins]), [[0.5], *starts])
        found = swap.improved(answer)
        assert [e.key for e in found.fitted.effects] == [FRICTION.key, CENTRE.key]
        values = found.fitted.hypothesis.values[1]
        assert np.allclose(values[:3], LOAD[:3], rtol=0.1, atol=0.01)


def test_another_form_starts_where_the_first_one_ended() -> None:
    scorer, nominal = loaded()
    answer = score(scorer, nominal.with_effects([FRICTION, CENTRE]), [[0.5], [0.4, 0.0, 0.0, 0.0]])
    back = fit_in_form(scorer.comparison, answer.fitted, CENTRE, POINT)
    assert [e.key for e in back.effects] == [FRICTION.key, POINT.key]
    again = fit_in_form(scorer.comparison, back, POINT, CENTRE)
    assert again.cost < 0.5 * back.cost
    own = values_of(CENTRE.parameters, again.free[again.structure.slice_of(CENTRE)])
    assert np.allclose(own[:3], LOAD[:3], rtol=0.1, atol=0.01)


def test_what_was_replaced_does_not_return(monkeypatch: pytest.MonkeyPatch) -> None:
    """However close the fits: here the last one always counts as the better one."""
    scorer, nominal = loaded()
    base = score(scorer, nominal, [])
    several = [MASS, POINT, CENTRE]
    swap = SwapStep(scorer.comparison, scorer.comparison, scorer, several, base, SearchSettings())
    answer = score(scorer, nominal.with_effects([FRICTION, POINT]), [[0.8], [0.5]])
    monkeypatch.setattr(SwapStep, "_better", lambda self, tried, *_, **__: next(iter(tried), None))
    said: list[str] = []
    swap.improved(answer, said.append)
    left = [line.split(" for ")[0] for line in said]
    assert left and len(set(left)) == len(left)
