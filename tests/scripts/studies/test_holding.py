"""The studies of holding and of opening: their geometry, and that an interrupted one goes on."""

from __future__ import annotations

import dataclasses
import importlib
import json
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

pytest.importorskip("matplotlib")

import loose_env
from loose_env.arms import LinearArm, planar, six_axis
from loose_env.diagnosis import SensorFloor, predict
from loose_env.excitation import Excitation, torque_signals
from loose_env.faults import StructuralLooseness
from loose_env.report import stored_rows, study_head, write_study
from scripts.study_parts.holding_tables import median_error


@pytest.fixture(scope="module")
def holding() -> ModuleType:
    return importlib.import_module("scripts.studies.holding")


def test_the_true_direction_is_that_of_the_column_the_seat_adds(holding: ModuleType) -> None:
    for arm in (planar(3), six_axis()):
        pose = arm.random_pose(np.random.default_rng(4))
        linear = LinearArm(arm, points=2)
        fault = StructuralLooseness(
            link=2, direction=(0.3, -0.9, 0.0), gap=1e-4, stiffness=(1e5, 1e5)
        )
        slides = linear.at(pose).jacobian[:, linear.slide_dofs[1]]
        column = slides @ np.array(fault.direction)[: slides.shape[1]]
        column /= np.linalg.norm(column)
        found = holding.seat_direction(arm, pose, fault)
        assert holding.angle_between(found, column) < 1e-4


def test_a_played_command_of_even_spectrum_transmits_what_is_predicted(holding: ModuleType) -> None:
    at = LinearArm(planar(3, hold="compliant"), points=145).at([0.2, 0.9, -0.4])
    shake = Excitation(torque_rms=(5.0, 0.0, 0.0), duration=1.2, band=(30.0, 150.0))
    expected = predict(at, shake, SensorFloor(joint=0.0, tool=0.0)).transmission_by_instrument
    lines = np.zeros(601, dtype=complex)
    lines[36:181] = 1.0
    even = holding.played_transmission(at, 0, np.fft.irfft(lines, n=1200))
    np.testing.assert_allclose(even, expected[:, 0], rtol=1e-6)
    uneven = torque_signals(shake, timestep=1e-3, before=0, after=0, rng=np.random.default_rng(0))
    other = holding.played_transmission(at, 0, uneven[0])
    assert np.linalg.norm(other - expected[:, 0]) > 0.02 * np.linalg.norm(expected)


def test_on_soft_gears_only_the_whole_dynamic_model_finds_the_direction(
    holding: ModuleType,
) -> None:
    settings = dataclasses.replace(holding.Settings(), planar_cases=6)
    stiff = holding.holding_row(settings, "planar3", "brake", 800.0, 1)
    soft = holding.holding_row(settings, "planar3", "gears", 45.0, 1)
    assert stiff["lost"] == soft["lost"] == 0
    assert median_error(stiff, "reference_command") < 5
    assert median_error(soft, "kinematic_command") > 10
    for estimator in ("lines_healthy", "lines_nominal"):
        assert median_error(soft, estimator) < 3
        assert np.median(soft["errors_link_known"][estimator]) < 3
        assert np.mean(soft["link_right"][estimator]) > 0.6
        assert len(soft["evidence"][estimator]) == 6


def test_an_interrupted_study_goes_on_with_the_same_settings_only(
    holding: ModuleType, tmp_path: Path
) -> None:
    settings = holding.quick(holding.Settings())
    path = tmp_path / "rows.json"
    document = study_head("scripts/studies/holding.py", settings, version=loose_env.__version__)
    write_study(path, document, [{"mode_hz": 70.0}])
    assert json.loads(path.read_text())["made_by"] == "scripts/studies/holding.py"
    assert stored_rows(path, document) == [{"mode_hz": 70.0}]
    other = study_head(
        "scripts/studies/holding.py",
        dataclasses.replace(settings, level=1.0),
        version=loose_env.__version__,
    )
    assert stored_rows(path, other) == []


def test_gravity_along_the_seat_shuts_it() -> None:
    opening = importlib.import_module("scripts.studies.opening")
    settings = dataclasses.replace(
        opening.Settings(), gravities=(0.0, 1.0), gaps=(4e-4,), levels=(1.0,), repeats=2
    )
    across, along = opening.opening_rows(settings, 1, lambda line: None)
    assert min(across["lost_share"]) > 0.2
    assert max(np.abs(along["lost_share"])) < 0.15
