"""Free responses from a start that is known to the sensors' noise only."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from loose_env.gap.fitting.gauss_newton import sensitivities
from loose_env.gap.fitting.holdout_score import Scorer
from loose_env.gap.fitting.initial_state import InitialStates
from loose_env.gap.fitting.model_structure import ModelStructure, Nuisance
from loose_env.gap.model.effects.catalogue import CATALOGUE
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.recording import Run
from tests.gap.cases.recorded_runs import PENDULUM, compared, fitted, measurable, pendulum_run

STARTS = [(1.2, 0.4), (-0.9, 1.5), (0.6, -2.0)]


def pendulum() -> NominalModel:
    return NominalModel(mujoco.MjSpec.from_string(PENDULUM))


def decays(count: int, *, viscous: float, coulomb: float, noise: float = 1e-3) -> list[Run]:
    rng = np.random.default_rng(4)
    return [
        pendulum_run(
            rng, viscous=viscous, coulomb=coulomb, start=start, noise=noise, name=f"run-{k}"
        )
        for k, start in enumerate(STARTS[:count])
    ]


def test_a_start_is_known_as_well_as_it_says() -> None:
    machine = pendulum()
    comparison = compared(machine, decays(3, viscous=0.003, coulomb=0.0))
    starts = InitialStates(machine, comparison.trials, comparison.channels)
    assert starts.moving == (0, 1, 2)
    for k, (angle, speed) in enumerate(STARTS):
        off = (
            abs(angle - comparison.trials[k].position[0]),
            abs(speed - comparison.trials[k].speed[0]),
        )
        assert off[0] < 4 * starts.spreads[k, 0, 0]
        assert off[1] < 4 * starts.spreads[k, 1, 0]


def test_sensitivities_of_all_runs_from_one_set_of_simulations() -> None:
    machine = pendulum()
    comparison = compared(machine, decays(3, viscous=0.003, coulomb=0.0))
    starts = InitialStates(machine, comparison.trials, comparison.channels)
    structure = ModelStructure(nuisance=Nuisance(initial=starts))
    free = np.zeros(len(starts.parameters))
    residual = comparison.residuals([structure.hypothesis(free)])[0]
    before = comparison.simulated
    found = sensitivities(comparison, structure, free, residual, range(len(free)))
    simulations = comparison.simulated - before
    # two, and the one they are compared with
    assert simulations == 3 * sum(trial.steps for trial in comparison.trials)
    one_by_one = np.stack(
        [
            (comparison.residuals([structure.hypothesis(0.05 * unit)])[0] - residual) / 0.05
            for unit in np.eye(len(free))
        ],
        axis=1,
    )
    assert np.allclose(found, one_by_one, atol=1e-6 * np.abs(one_by_one).max())
    for k in range(3):
        assert not found[comparison.rows.trial != k, 2 * k : 2 * k + 2].any()


def test_a_pendulum_decays_by_both_frictions() -> None:
    machine = pendulum()
    comparison = compared(machine, decays(3, viscous=0.004, coulomb=0.015))
    plain, _ = fitted(comparison, [])
    viscous = CATALOGUE["viscous_friction"](machine, "pivot")
    coulomb = CATALOGUE["coulomb_friction"](machine, "pivot")
    one, _ = fitted(comparison, [viscous])
    other, _ = fitted(comparison, [coulomb])
    both, values = fitted(comparison, [viscous, coulomb])
    print(f"{plain.rms:.1f} -> {one.rms:.2f}, {other.rms:.2f} -> {both.rms:.3f}", values)
    assert plain.rms > 50
    assert both.rms < 1.3
    assert min(one.rms, other.rms) > 1.5 * both.rms
    assert abs(values[0][0] / 0.004 - 1) < 0.1
    assert abs(values[1][0] / 0.015 - 1) < 0.1


def test_the_start_is_fitted_on_held_out_runs_too() -> None:
    machine = pendulum()
    runs = decays(3, viscous=0.004, coulomb=0.0)
    shown, hidden = compared(machine, runs[:2]), compared(machine, runs[2:])
    found, _ = fitted(shown, [CATALOGUE["viscous_friction"](machine, "pivot")])
    scored = Scorer(shown, hidden).score(found)
    assert found.rms < 1.2
    assert scored.held_out_rms < 1.3
    as_measured = found.hypothesis.of_model
    assert np.sqrt(np.mean(hidden.residuals([as_measured]) ** 2)) > 2 * scored.held_out_rms


def test_a_run_at_rest_has_no_start_to_fit() -> None:
    machine = pendulum()
    run = decays(1, viscous=0.004, coulomb=0.0)[0]
    still = Run(
        name="still",
        time=run.time,
        sensors={"encoder": np.random.default_rng(0).normal(0, 1e-3, run.samples)},
        torques={"pivot": np.zeros(run.samples)},
    )
    comparison = compared(machine, [still, run])
    starts = InitialStates(machine, comparison.trials, comparison.channels)
    assert starts.moving == (1,)
    assert [p.name for p in starts.parameters] == ["position.pivot.run-0", "speed.pivot.run-0"]
    position, speed = starts.offsets(np.array([0.1, 0.2]))
    assert position.tolist() == [[0.0], [0.1]] and speed.tolist() == [[0.0], [0.2]]
    structure = ModelStructure(nuisance=Nuisance(initial=starts))
    assert np.isfinite(comparison.residuals([structure.hypothesis(structure.nominal_start)])).all()


@pytest.mark.parametrize("lost", [3, 12, 20])
def test_a_speed_that_is_lost_where_a_run_begins_is_known_as_well_as_it_says(lost: int) -> None:
    machine = NominalModel(measurable(mujoco.MjSpec.from_string(PENDULUM)))
    rng = np.random.default_rng(2)
    run = pendulum_run(
        rng, viscous=0.003, coulomb=0.0, start=STARTS[0], noise=1e-5, rate=1000.0, duration=1.0
    )
    speed = np.gradient(run.sensors["encoder"], run.time) + rng.normal(0, 1e-2, run.samples)
    speed[:lost] = np.nan
    comparison = compared(machine, [replace(run, sensors={**run.sensors, "pivot_vel": speed})])
    starts = InitialStates(machine, comparison.trials, comparison.channels)
    off = abs(comparison.trials[0].speed[0] - STARTS[0][1])
    assert np.isfinite(starts.spreads).all()
    assert off < 4 * starts.spreads[0, 1, 0] < 4.0
