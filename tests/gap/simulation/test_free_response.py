"""Free responses from a start that is known to the sensors' noise only."""

from __future__ import annotations

import mujoco
import numpy as np

from loose_env.gap.fitting.initial_state import InitialStates
from loose_env.gap.model.effects.catalogue import CATALOGUE
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.recording import Run
from tests.gap.cases.recorded_runs import PENDULUM, compared, fitted, pendulum_run

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
