"""The inertia matrix with a seat against closed forms."""

import numpy as np
import pytest

from loose_env.arms import planar
from loose_env.errors import InvalidData
from loose_env.faults import Backlash, Healthy, StructuralLooseness
from loose_env.thesis.methods.looseness.looseness_joint import (
    backlash_condition,
    condition_of,
    seated_inertia,
)

POSE = np.array([0.2, 0.8])


def slide(link: int, direction: tuple[float, float, float]) -> StructuralLooseness:
    return StructuralLooseness(link=link, direction=direction, gap=2e-4, stiffness=(1e5, 1e5))


def play(joint: int) -> Backlash:
    return Backlash(joint=joint, gap=1e-4, stiffness=(1e4, 1e4))


def test_the_joints_share_of_the_matrix_does_not_change():
    arm = planar(2)
    nominal = seated_inertia(arm, POSE, Healthy())
    for fault in (slide(1, (1, 0, 0)), slide(2, (0, 1, 0)), play(1), play(2)):
        loose = seated_inertia(arm, POSE, fault)
        assert loose.shape == (3, 3)
        np.testing.assert_allclose(loose[:2, :2], nominal, rtol=1e-12)


def test_a_slide_weighs_what_lies_beyond_it():
    loose = seated_inertia(planar(2), POSE, slide(2, (0.6, 0.8, 0)))
    # Link 2 weighs 3 kg, a twentieth of it is the flange on the joint's side.
    assert loose[2, 2] == pytest.approx(0.95 * 3.0)


def test_play_splits_the_joints_own_inertia():
    loose = seated_inertia(planar(2), POSE, play(2))
    assert loose[2, 1] == pytest.approx(loose[2, 2])
    ratio = loose[1, 1] / loose[2, 2] - 1
    assert condition_of(loose[1:, 1:]).scaled == pytest.approx(backlash_condition(ratio))


def test_the_closed_form():
    for ratio in (1e-4, 0.1, 1.0, 30.0):
        m = np.array([[1 + ratio, 1.0], [1.0, 1.0]])
        assert condition_of(m).scaled == pytest.approx(backlash_condition(ratio), rel=1e-6)
    assert backlash_condition(1e-6) == pytest.approx(4e6, rel=1e-5)


def test_units_change_the_raw_figure_only():
    m = seated_inertia(planar(2), POSE, slide(2, (0, 1, 0)))
    millimetres = np.diag([1, 1, 1e-3]) @ m @ np.diag([1, 1, 1e-3])
    assert condition_of(millimetres).scaled == pytest.approx(condition_of(m).scaled)
    assert condition_of(millimetres).raw > 100 * condition_of(m).raw


def test_bad_input_is_refused():
    with pytest.raises(InvalidData, match="positive definite"):
        condition_of([[1.0, 2.0], [2.0, 1.0]])
