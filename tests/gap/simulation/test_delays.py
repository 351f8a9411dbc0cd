"""A delay that lies whole samples from where a fit ends is found all the same."""

from __future__ import annotations

import mujoco
import numpy as np

from loose_env.gap.fitting.gauss_newton import fit, started
from loose_env.gap.model.effects.catalogue import CATALOGUE
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.model.parameter import values_of
from loose_env.gap.selection.screening.window_fits import WindowFits
from loose_env.recording import Run
from tests.gap.cases.gap_case import nominal_structure
from tests.gap.cases.level_arm import EVERY, FINE, LEVEL, NOISE
from tests.gap.cases.recorded_runs import compared

LATE = 34
"""How late the accelerometer is, in fine steps: 6.8 samples."""


def late_runs(count: int) -> list[Run]:
    """Runs whose commands jump from sample to sample, and an accelerometer that shows the past."""
    model = mujoco.MjModel.from_xml_string(LEVEL)
    model.opt.timestep = FINE
    rng, runs = np.random.default_rng(3), []
    for number in range(2):
        time = np.arange(count) * FINE * EVERY
        controls = 0.3 * np.sin(np.outer(time, (9.0, 14.0, 23.0)) + number)
        controls *= np.minimum(4 * time, 1.0)[:, None]
        data = mujoco.MjData(model)
        mujoco.mj_step(model, data, 2000)
        shown, shaken = np.zeros((count, 4)), np.zeros((count * EVERY, 3))
        for k in range(count * EVERY):
            data.ctrl[:] = controls[k // EVERY]
            mujoco.mj_forward(model, data)
            shaken[k] = data.sensordata[4:]
            if k % EVERY == 0:
                shown[k // EVERY] = data.sensordata[:4]
            mujoco.mj_step(model, data)
        before = np.maximum(np.arange(0, count * EVERY, EVERY) - LATE, 0)
        noise = rng.normal(0, NOISE, (count, 7))
        names = ("encoder1", "encoder2", "encoder3", "rate3")
        sensors = {n: shown[:, c] + noise[:, c] for c, n in enumerate(names)}
        runs.append(
            Run(
                name=f"run-{number}.parquet",
                time=time,
                controls={f"servo{j + 1}": controls[:, j] for j in range(3)},
                sensors=sensors | {"shake": shaken[before] + noise[:, 4:]},
            )
        )
    return runs


def test_a_delay_that_is_samples_off_is_moved_to_where_it_belongs() -> None:
    machine = NominalModel(mujoco.MjSpec.from_string(LEVEL))
    comparison = compared(machine, late_runs(1200), step=FINE * EVERY / 2)
    nominal = nominal_structure(machine, tolerance=0.005)
    base = fit(comparison, nominal, nominal.nominal_start)
    windows = WindowFits(comparison, base)
    effect, truth = CATALOGUE["sensor_delay"](machine, "shake"), LATE * FINE
    found = []
    for samples in (-2.0, -1.0, 1.0, 3.0):
        start = started(base, effect, [truth + samples * FINE * EVERY])
        stuck = fit(comparison, nominal.plus(effect), start)
        moved = windows._shifted(stuck)
        assert moved.cost <= stuck.cost
        found.append([float(values_of(effect.parameters, f.free[-1:])[0]) for f in (stuck, moved)])
    ended, shifted = np.array(found).T
    assert np.max(np.abs(ended - truth)) > 0.5 * FINE * EVERY  # some fit ends a valley off
    # Euler's method, by which the runs were made, moves a reading by half a fine step
    np.testing.assert_allclose(shifted, truth, atol=0.7 * FINE)
    assert np.ptp(shifted) < 0.01 * FINE
