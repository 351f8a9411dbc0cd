"""Screening sees an effect of several axes whichever way it lies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from loose_env.gap.data.aligned_run import align_run, channels_of
from loose_env.gap.fitting.gauss_newton import fit
from loose_env.gap.model.effects.catalogue import CATALOGUE
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.gap.selection.screening.screening import ScreenedCandidate, screen
from loose_env.gap.selection.screening.signatures import Signatures
from tests.gap.cases.gap_case import STEP, nominal_structure, record

FLOORS = np.array([2e-5] * 3 + [2e-3] + [0.02] * 3)


def compared(folder: object, **options: object) -> ResidualModel:
    recording = record(folder, runs=2)  # type: ignore[arg-type]
    machine = NominalModel(recording.spec(), step=STEP, **options)  # type: ignore[arg-type]
    channels = channels_of(list(recording.runs))
    trials = [align_run(run, machine, channels, step=STEP) for run in recording.runs]
    return ResidualModel(machine, trials, channels, FLOORS, threads=1)


def screened(folder: object, bias: tuple[float, float, float]) -> dict[str, ScreenedCandidate]:
    """What a bias and a gain of the accelerometer promise where it has that bias [floors]."""
    whole = compared(folder)
    machine, trials, channels = whole.machine, whole.trials, whole.channels
    shown = whole.predict([Hypothesis()])[0]
    rng = np.random.default_rng(5)
    added = np.concatenate([np.zeros(4), bias]) * FLOORS
    measured = [
        replace(trial, measured=values + added + rng.normal(0, FLOORS, values.shape))
        for trial, values in zip(trials, shown, strict=True)
    ]
    comparison = ResidualModel(machine, measured, channels, FLOORS, threads=1)
    nominal = nominal_structure(machine)
    fitted = fit(comparison, nominal, nominal.nominal_start)
    candidates = [CATALOGUE[kind](machine, "shake") for kind in ("sensor_bias", "sensor_gain")]
    return {each.effect.kind: each for each in screen(comparison, fitted, candidates)}


@pytest.mark.parametrize("bias", [(-2.0, 1.0, 1.0), (2.0, 2.0, 2.0), (0.0, 3.0, -3.0)])
def test_a_bias_promises_what_it_explains_in_every_direction(
    tmp_path_factory: pytest.TempPathFactory, bias: tuple[float, float, float]
) -> None:
    found = screened(tmp_path_factory.mktemp("screening") / "recording", bias)
    explained = np.sum(np.square(bias)) / (7 + np.sum(np.square(bias)))
    assert found["sensor_bias"].predicted == pytest.approx(explained, abs=0.05)
    values = np.array(found["sensor_bias"].values) / FLOORS[4:]
    assert values == pytest.approx(bias, abs=0.3)


@pytest.mark.parametrize(
    ("kind", "where", "nothing"),
    [("command_delay", "all", (0.0,)), ("coulomb_friction", "joint1", (0.0,))],
)
def test_an_effect_of_no_size_has_no_signature(
    tmp_path_factory: pytest.TempPathFactory, kind: str, where: str, nothing: tuple[float, ...]
) -> None:
    comparison = compared(tmp_path_factory.mktemp("screening") / "recording", substeps=3)
    nominal = nominal_structure(comparison.machine)
    fitted = fit(comparison, nominal, nominal.nominal_start)
    effect = CATALOGUE[kind](comparison.machine, where)
    entries = [(effect, nothing)]
    ((_, _, signature),) = Signatures().of(comparison, fitted, entries, fitted.residual)
    assert np.abs(signature).max() < 1e-6
