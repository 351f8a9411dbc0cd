"""A loose link that strikes its stops in ordinary motions is found by how hard it strikes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest

from loose_env.gap.model.effects.catalogue import CATALOGUE, candidates
from loose_env.gap.model.effects.structural_looseness import StructuralLooseness
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.model.nominal_parameters import NominalParameters
from loose_env.gap.residuals.preparation.integrator_choice import corrected_step_notes
from loose_env.gap.residuals.preparation.prepare import GapProblem, prepare
from loose_env.gap.selection.impacts.impact_power import ImpactPower
from loose_env.gap.selection.impacts.impact_search import ImpactFit, find_impacts
from loose_env.gap.settings import GapSettings
from loose_env.recording import write_recording
from tests.gap.cases.level_arm import FINE, LEVEL, moving

COUNT = 1500
TRUE = np.array([1.0, 4e-4, 3.0, 3e5, 0.1])
"""Angle, gap, friction, stiffness and damping ratio."""


def prepared_arm(folder: Path, *, loose: bool = False, friction: float = 0.0) -> GapProblem:
    """Runs of moving commands, with a loose second link or with dry friction."""
    spec = mujoco.MjSpec.from_string(LEVEL)
    spec.option.timestep = FINE
    if loose:
        machine = NominalModel(mujoco.MjSpec.from_string(LEVEL), step=FINE)
        StructuralLooseness(machine, "link2").edit(spec, TRUE)
    spec.joint("joint2").frictionloss = friction
    speeds = [np.array([11.0 + k, 17.0 - 2 * k, 23.0 + k]) for k in range(3)]
    runs = moving(spec.compile(), speeds, size=0.25, count=COUNT)
    recording = write_recording(folder, model_xml=LEVEL, runs=runs)
    return prepare(recording, GapSettings(threads=1))


@pytest.fixture(scope="module")
def loose(tmp_path_factory: pytest.TempPathFactory) -> GapProblem:
    return prepared_arm(tmp_path_factory.mktemp("loose") / "r", loose=True)


def known(problem: GapProblem) -> Hypothesis:
    """The nominal model."""
    nominal = NominalParameters(problem.machine, tolerance=0.03)
    return Hypothesis(nominal=nominal, factors=np.ones(len(nominal.parameters)))


def with_trace(problem: GapProblem) -> Hypothesis:
    """The nominal model and an effect that is of no use."""
    trace = CATALOGUE["viscous_friction"](problem.machine, "joint3"), np.array([1e-3])
    return known(problem).with_effects([trace])


def slide(problem: GapProblem, link: str, values: np.ndarray) -> Hypothesis:
    effect = CATALOGUE["structural_looseness"](problem.machine, link)
    return Hypothesis(effects=(effect,), values=(values,))


def search(
    problem: GapProblem, kind: str, say: Callable[[str], None] = lambda _: None
) -> ImpactFit | None:
    return find_impacts(
        problem,
        with_trace(problem),
        candidates(problem.machine, (kind,)),
        np.random.default_rng(0),
        say=say,
    )


def test_powers_tell_a_slide_that_no_trajectory_follows(loose: GapProblem) -> None:
    nominal, nothing = known(loose), Hypothesis()
    # a little off in what nobody knows exactly: when stops are struck is another matter then
    near = slide(loose, "link2", TRUE * [1.0, 1.05, 1.1, 0.8, 1.2])
    whole = nominal.with_effects(near.pairs)
    impact_power = ImpactPower(loose.held_out, nominal)
    assert np.allclose(impact_power.residuals([nothing])[0], impact_power.measured, atol=1e-9)
    before, after, other = (
        float(np.mean(r**2))
        for r in impact_power.residuals([nothing, near, slide(loose, "link3", TRUE)])
    )
    assert after < 2.0 < other and before > 10 * after
    by_sample = np.mean(loose.held_out.residuals([nominal, whole]) ** 2, axis=1)
    assert by_sample[1] > 0.2 * by_sample[0]


@pytest.mark.slow
def test_the_loose_link_is_found_with_its_direction(loose: GapProblem) -> None:
    found = search(loose, "structural_looseness")
    assert found is not None and found.effect.where == "link2"
    assert found.explained > 0.85 and "link2 hits its stops" in found.description
    assert [effect.kind for effect in found.insignificant] == ["viscous_friction"]
    angle, gap = found.fitted.free[0] * 0.5, found.intervals
    assert np.cos(angle - TRUE[0]) ** 2 > 0.98
    assert gap.low[1] < gap.high[1] and 0.5 < found.intervals.high[1] / TRUE[1] < 4


def test_no_step_is_blamed_for_blows(loose: GapProblem) -> None:
    assert corrected_step_notes(loose.held_out_whole, slide(loose, "link2", TRUE)) == []
