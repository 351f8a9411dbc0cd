"""Whether a run opens a seat against friction: a force where it slides, a torque where it turns."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from loose_env.instrument.inference import opening_probability as openness
from loose_env.instrument.inference.opening_probability import open_probability

N = 2


def answer(force: float, *, sliding: tuple[bool, ...]) -> SimpleNamespace:
    """A response in which every seat transmits an rms force or torque, and gravity loads none."""
    lines = SimpleNamespace(spacing=1.0, seconds=1.0, period=1.0)
    across = np.full((1, 1), force / np.sqrt(2))
    arm = SimpleNamespace(n=N, nominal=SimpleNamespace(sliding=np.array(sliding)))
    at = SimpleNamespace(of=SimpleNamespace(arm=arm), seat_load=lambda: np.zeros(4 * N))
    return SimpleNamespace(lines=lines, at=at, across=lambda seats, axes: across)


def chance(force: float, columns: list[int], *, sliding: tuple[bool, ...]) -> float:
    axes = np.eye(len(columns))[:1]
    seats = np.array(columns, dtype=np.intp)
    return float(open_probability(answer(force, sliding=sliding), seats, axes)[0])  # type: ignore[arg-type]


@pytest.mark.parametrize("force", [0.3, 3.0, 30.0])
def test_play_of_a_sliding_joint_is_held_by_a_force_like_a_slide(force: float) -> None:
    slide = chance(force, [0, 1, 2], sliding=(False, True))
    assert chance(force, [3 * N + 1], sliding=(False, True)) == pytest.approx(slide)
    turn = chance(force, [3 * N], sliding=(False, True))
    assert turn > slide  # as many newton metres are far more than as many newtons
    assert turn == pytest.approx(chance(force / openness._LEVER, [0, 1, 2], sliding=(False, True)))
