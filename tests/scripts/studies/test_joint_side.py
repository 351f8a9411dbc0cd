"""The study of torque and encoder alone: its indices and its AUC."""

from __future__ import annotations

import importlib
from types import ModuleType

import numpy as np
import pytest

from loose_env.arms import planar


@pytest.fixture(scope="module")
def study() -> ModuleType:
    return importlib.import_module("scripts.studies.thesis.joint_side")


def test_the_auc_counts_pairs(study: ModuleType) -> None:
    assert study.auc(np.array([2.0, 3.0]), np.array([0.0, 1.0])) == 1.0
    assert study.auc(np.array([1.0, 1.0]), np.array([1.0, 1.0])) == 0.5
    assert study.auc(np.array([0.0, 2.0]), np.array([1.0, 3.0])) == 0.25


def test_play_shows_in_torque_and_encoder(study: ModuleType) -> None:
    settings = study.Settings(arms=6)
    loose, healthy = study.study(planar(2), "backlash@joint", settings)
    assert loose.shape == healthy.shape == (6, len(study.INDICES))
    assert np.isfinite(loose).all() and np.isfinite(healthy).all()
    assert study.auc(loose[:, 0], healthy[:, 0]) > 0.7
