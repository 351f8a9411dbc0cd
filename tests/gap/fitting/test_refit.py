"""Fits reach the noise where figures nearly cancel: heavier links on stronger servos."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from loose_env.gap.data.aligned_run import align_run, channels_of
from loose_env.gap.fitting.gauss_newton import fit
from loose_env.gap.fitting.refit import fit_without, needed_least, refit_with_new_jacobian
from loose_env.gap.model.effects.catalogue import CATALOGUE
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.model.parameter import free_of
from loose_env.gap.residuals.residual_model import ResidualModel
from tests.gap.cases.gap_case import STEP, nominal_structure, record

FLOORS = np.array([2e-7] * 3 + [2e-5] + [0.0005] * 3)
"""Fine sensors: a percent of a figure is thousands of noise standard deviations."""


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_weak_servo_beside_figures_at_their_tolerance_is_fitted_to_the_noise(
    tmp_path_factory: pytest.TempPathFactory, seed: int
) -> None:
    recording = record(tmp_path_factory.mktemp("valley") / "recording")
    rng = np.random.default_rng(seed)
    machine = NominalModel(
        recording.spec(), step=STEP, integrator=int(mujoco.mjtIntegrator.mjINT_RK4)
    )
    channels = channels_of(list(recording.runs))
    trials = [align_run(run, machine, channels, step=STEP) for run in recording.runs[:2]]
    weak = CATALOGUE["actuator_gain"](machine, "servo2")
    structure = nominal_structure(machine).plus(weak)
    count = len(structure.nuisance.parameters)
    factors = 1 + 0.03 * rng.choice([-1.0, 1.0], count)

    def free(factors: float | np.ndarray, gain: float) -> np.ndarray:
        return free_of(structure.parameters, np.append(np.broadcast_to(factors, count), gain))

    shown = ResidualModel(machine, trials, channels, FLOORS, threads=1).predict(
        [structure.hypothesis(free(factors, 0.4))]
    )[0]
    measured = [
        replace(trial, measured=values + rng.normal(0, FLOORS, values.shape))
        for trial, values in zip(trials, shown, strict=True)
    ]
    comparison = ResidualModel(machine, measured, channels, FLOORS, threads=1)
    start = free(1.0, 0.45)
    found = fit(comparison, structure, start)
    assert comparison.residuals([structure.hypothesis(start)])[0].std() > 50
    assert found.rms < 3
    assert refit_with_new_jacobian(comparison, found).rms < 1.02


def test_what_is_needed_least_is_what_a_refit_misses_least(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    recording = record(tmp_path_factory.mktemp("needed") / "recording")
    machine = NominalModel(
        recording.spec(), step=STEP, integrator=int(mujoco.mjtIntegrator.mjINT_RK4)
    )
    channels = channels_of(list(recording.runs))
    trials = [align_run(run, machine, channels, step=STEP) for run in recording.runs[:1]]
    effects = [CATALOGUE["coulomb_friction"](machine, f"joint{j}") for j in (1, 2, 3)]
    structure = nominal_structure(machine).plus(*effects)
    count = len(structure.nuisance.parameters)
    rng = np.random.default_rng(5)
    values = np.concatenate([np.ones(count), [0.1, 0.01, 0.03]])
    comparison = ResidualModel(machine, trials, channels, FLOORS, threads=1)
    shown = comparison.predict([structure.hypothesis(free_of(structure.parameters, values))])[0]
    measured = [
        replace(trial, measured=found + rng.normal(0, FLOORS, found.shape))
        for trial, found in zip(trials, shown, strict=True)
    ]
    comparison = ResidualModel(machine, measured, channels, FLOORS, threads=1)
    start = free_of(structure.parameters, np.concatenate([np.ones(count), np.full(3, 0.02)]))
    whole = refit_with_new_jacobian(comparison, fit(comparison, structure, start))
    order = needed_least(comparison, whole, effects)
    exact = {id(e): fit_without(comparison, whole, e).cost for e in effects}
    assert min(exact.values()) > whole.cost
    assert [id(e) for e in order] == sorted(exact, key=lambda key: exact[key])
    for effect in effects:
        roughly = fit_without(comparison, whole, effect, roughly=True)
        # no more than a few percent of what is lost are left to gain
        assert roughly.cost - exact[id(effect)] < 0.3 * (exact[id(effect)] - whole.cost)
