"""The slide rig with the looseness joint: tight, loose, and with its screw loose too."""

from __future__ import annotations

import numpy as np
import pytest

from loose_env.statistics import axial_difference, kurtosis
from loose_env.thesis.ch6_experiments.slide.experiment_four import (
    FINGER,
    LOOSE,
    TIGHT,
    Trial,
    trials,
)


@pytest.fixture(scope="module")
def bolted() -> dict[str, tuple[Trial, ...]]:
    return {state: trials(5, state, "bolted", records=3) for state in (TIGHT, FINGER, LOOSE)}


def off(trial: Trial, direction: float, *, relative: bool = False) -> float:
    turn = axial_difference(trial.lowest(relative=relative).mean, direction)
    return abs(float(np.degrees(turn)))


@pytest.mark.parametrize("state", [TIGHT, FINGER])
def test_with_preload_the_minimum_lies_across_the_motion(
    bolted: dict[str, tuple[Trial, ...]], state: str
) -> None:
    for trial in bolted[state]:
        assert off(trial, np.pi / 2 - trial.angle) < 2.0


def test_without_preload_the_minimum_lies_along_the_joint(
    bolted: dict[str, tuple[Trial, ...]],
) -> None:
    for trial in bolted[LOOSE]:
        assert off(trial, 0.0) < 15.0


def test_relative_acceleration_shows_the_opposite(bolted: dict[str, tuple[Trial, ...]]) -> None:
    # What the joint does not pass on lies along it, so across it there is nothing.
    for trial in bolted[LOOSE]:
        assert off(trial, np.pi / 2, relative=True) < 5.0


def test_kurtosis_along_the_joint_rises(bolted: dict[str, tuple[Trial, ...]]) -> None:
    def along(trial: Trial) -> float:
        return float(np.mean([kurtosis(a, (1.0, 0.0)) for _, a in trial.pairs()]))

    risen = [
        along(loose) > 10 * max(along(tight), 0.1)
        for loose, tight in zip(bolted[LOOSE], bolted[TIGHT], strict=True)
    ]
    assert sum(risen) >= 3


def test_a_loose_screw_hides_the_direction() -> None:
    found = [off(trial, 0.0) for trial in trials(5, LOOSE, "loose", records=3)]
    assert np.sqrt(np.mean(np.square(found))) > 25.0
