"""The study of link finding runs, and its parts do what they say."""

from __future__ import annotations

import importlib
from types import ModuleType

import numpy as np
import pytest

from loose_env.arms import planar, scara
from loose_env.diagnosis import ToolFrames


@pytest.fixture(scope="module")
def study() -> ModuleType:
    return importlib.import_module("scripts.studies.links")


def test_a_quick_run_prints_both_tables(
    study: ModuleType, capsys: pytest.CaptureFixture[str]
) -> None:
    study.main(["--quick", "--arm", "planar4"])
    printed = capsys.readouterr().out
    assert "scatter 20 degrees" in printed
    assert "(b) simulated" in printed
    assert printed.count("images all") == 5


def test_scatter_has_the_standard_deviation_asked_for(study: ModuleType) -> None:
    rng, true = np.random.default_rng(0), np.array([0.0, 0.6, 0.8])
    drawn = np.array([study.scattered(true, 0.1, rng) for _ in range(4000)])
    angle = np.arccos(drawn @ true)
    assert np.sqrt(np.mean(angle**2) / 2) == pytest.approx(0.1, rel=0.04)


def test_the_bound_counts_links_that_no_move_tells_apart(study: ModuleType) -> None:
    assert study.bound(ToolFrames(planar(4)), 20, 0) == 1.0
    # Links 2 and 3 of a SCARA are alike: half of their cases are lost.
    assert study.bound(ToolFrames(scara()), 40, 0) == pytest.approx(0.75)


def test_images_need_fewer_poses_than_turns(study: ModuleType) -> None:
    right = study.by_scatter(ToolFrames(planar(4)), np.radians(5), 40, 2, 3)
    by_method = dict(zip(study.METHODS, right[:, 1], strict=True))
    assert by_method["images all"] > 0.9
    assert by_method["images all"] > by_method["4.31 outward"] + 0.2
