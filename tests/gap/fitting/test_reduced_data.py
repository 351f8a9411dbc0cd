"""Differences by a cheaper integrator: near those of the exact one, and never where it is lost."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from loose_env.gap.data.aligned_run import Trial, align_run, channels_of
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.effects.catalogue import CATALOGUE
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.gap.simulation.time_step import step_with
from loose_env.recording import Recording
from tests.gap.cases.gap_case import STEP, nominal_structure, record


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return record(tmp_path_factory.mktemp("lighter") / "recording")


def comparison_of(recording: Recording, *, parts: int, joined: int) -> ResidualModel:
    """The runs at a part of the sample interval, as long as the model says or much finer."""
    machine = NominalModel(
        recording.spec(), step=STEP / parts, integrator=int(mujoco.mjtIntegrator.mjINT_RK4),
        merged_steps=joined,
    )  # fmt: skip
    channels = channels_of(list(recording.runs))
    trials = [align_run(run, machine, channels, step=STEP / parts) for run in recording.runs[:2]]
    floors = np.array([2e-5] * 3 + [2e-3] + [0.02] * 3)
    return ResidualModel(machine, trials, channels, floors, threads=1)


def beginning(effect: Effect) -> Hypothesis:
    """The nominal model and an effect, as a fit begins."""
    return Hypothesis().with_effects([(effect, np.array(effect.starts[0]))])


@pytest.mark.parametrize("joined", [1, 2])
def test_changes_by_the_cheaper_integrator_are_near_the_exact_ones(
    recording: Recording, joined: int
) -> None:
    comparison = comparison_of(recording, parts=2, joined=joined)
    assert comparison.with_cheaper_integrator() is comparison.with_cheaper_integrator()
    nominal = nominal_structure(comparison.machine)
    free = nominal.nominal_start
    tried = [nominal.hypothesis(free + 0.05 * row) for row in (0 * free, *np.eye(len(free)))]
    exact, cheap = (
        (found[1:] - found[0]) / 0.05
        for found in (
            comparison.residuals(tried),
            comparison.with_cheaper_integrator().residuals(tried),
        )
    )
    size, off = (np.linalg.norm(rows, axis=1) for rows in (exact, cheap - exact))
    seen = size > 1.0  # a figure that these runs show
    assert seen.sum() >= 6
    assert np.median(off[seen] / size[seen]) < 0.05
    # beside what the runs show best, an error in what they hardly show is none
    assert np.all(off[seen] < 0.05 * size.max())


def test_joined_steps_cost_half_and_show_the_same(recording: Recording) -> None:
    every, joined = (comparison_of(recording, parts=2, joined=count) for count in (1, 2))
    nothing = Hypothesis()
    left = [each.residuals([nothing])[0] for each in (every, joined)]
    assert 0 < np.std(left[0] - left[1]) < 0.05  # noise standard deviations
    assert joined.simulated < 0.51 * every.simulated


def test_a_spring_keeps_every_step(recording: Recording) -> None:
    every, joined = (comparison_of(recording, parts=2, joined=count) for count in (1, 2))
    spring = CATALOGUE["joint_compliance"](every.machine, "joint2")
    hypothesis = beginning(spring)
    left = [each.residuals([hypothesis])[0] for each in (every, joined)]
    assert np.array_equal(left[0], left[1])
    stiff = joined.with_cheaper_integrator(stiff=True)
    stiff.residuals([Hypothesis()])
    assert stiff.simulated == every.simulated


def test_steps_are_joined_where_no_sample_comes_between(recording: Recording) -> None:
    def trial(parts: int) -> Trial:
        return comparison_of(recording, parts=parts, joined=1).trials[0]

    joined, whole = trial(2).coarser(2), trial(1)
    assert (joined.step, joined.steps) == (whole.step, whole.steps)
    assert np.array_equal(joined.controls, whole.controls)
    assert trial(3).coarser(2).step == trial(3).step  # every other sample lies between two
    assert trial(3).coarser(4).step == trial(1).step  # but three in one do


def test_where_the_cheaper_integrator_is_lost_it_is_not_used(recording: Recording) -> None:
    comparison = comparison_of(recording, parts=2, joined=2)
    nominal = nominal_structure(comparison.machine)
    hypothesis = nominal.hypothesis(nominal.nominal_start)
    residual = comparison.residuals([hypothesis])[0]
    used, left = comparison.cheaper_residual(hypothesis, residual)
    assert used is comparison.with_cheaper_integrator() and len(left) == len(residual)
    lost = comparison.with_cheaper_integrator()
    lost.measured = lost.measured + 5e3  # as if it had run away
    used, left = comparison.cheaper_residual(hypothesis, residual)
    assert used is comparison
    assert left is residual


@pytest.mark.parametrize("kind", ["joint_compliance", "coulomb_friction"])
def test_what_is_sharp_takes_steps_half_as_long(recording: Recording, kind: str) -> None:
    def left(parts: int, effect: str | None, **settings: int | bool) -> np.ndarray:
        comparison = comparison_of(recording, parts=parts, joined=1)
        machine = replace(comparison.machine, **settings)  # type: ignore[arg-type]
        own = ResidualModel(
            machine, comparison.trials, comparison.channels, comparison.floors, threads=1
        )
        if effect is None:
            return own.residuals([Hypothesis()])[0]
        sharp = CATALOGUE[effect](machine, "joint2")
        assert step_with(machine, [sharp]) == machine.step / (
            1 if "uniform_steps" in settings else 2
        )
        return own.residuals([beginning(sharp)])[0]

    assert np.array_equal(left(1, None, substeps=2), left(1, None))
    cut, fine = left(1, kind, substeps=2), left(2, kind, uniform_steps=True)
    assert np.std(cut - fine) < 1e-6 * np.std(fine)
    assert np.std(cut - left(1, kind, uniform_steps=True)) > 0
