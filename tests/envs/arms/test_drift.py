"""Drift of joint zeros and drive gains of the true arm between records."""

from __future__ import annotations

import copy
import itertools

import numpy as np
import pytest

from loose_env.arms import Drift, planar
from loose_env.envs import DiagnosisSettings, EpisodeBatch
from loose_env.errors import InvalidSetting
from loose_env.typing import Array

DRIFTING = DiagnosisSettings(engine="reduced", drift=Drift(joint_zero=0.5, gain=0.02))
STEADY = DiagnosisSettings(engine="reduced")
ARM = planar(2)


def played(settings: DiagnosisSettings, *, beside: int = 0) -> tuple[list[Array], list[Array]]:
    """Zeros of the joints and observations after each of three records of one episode."""
    batch = EpisodeBatch(ARM, settings, num=1 + beside, threads=1)
    for slot in range(1 + beside):
        batch.start(slot, seed=3, number=slot, options={"fault": "healthy"})
    zeros, seen = [], []
    action = batch.actions.encode(levels=np.array([3, 3]), duration=0)
    for _ in range(3):
        batch.step(list(range(1 + beside)), [action] * (1 + beside))
        mismatch = batch.episode(0).mismatch
        assert mismatch is not None
        zeros.append(mismatch.joint_zero)
        seen.append(batch.observe(0))
    return zeros, seen


def test_the_first_record_is_of_the_arm_as_drawn_and_later_ones_of_one_that_walks() -> None:
    steady, as_drawn = played(STEADY)
    walked, seen = played(DRIFTING)
    np.testing.assert_array_equal(walked[0], steady[0])
    np.testing.assert_array_equal(seen[0], as_drawn[0])
    for before, after in itertools.pairwise(walked):
        assert np.all(before != after)
        assert np.all(np.abs(after - before) <= np.radians(3 * 0.5))
    assert not np.array_equal(seen[2], as_drawn[2])


def test_nominal_columns_know_nothing_of_the_drift() -> None:
    layout = EpisodeBatch(ARM, DRIFTING, num=1, threads=1).observations
    named = [e.name for e in layout.slot_elements]
    nominal = [k for k, name in enumerate(named) if name.startswith("nominal")]
    assert nominal
    steady, drifting = (layout.slots_of(played(s)[1][-1])[2] for s in (STEADY, DRIFTING))
    np.testing.assert_array_equal(steady[nominal], drifting[nominal])


def test_an_episode_drifts_alike_beside_others_and_from_a_saved_state() -> None:
    np.testing.assert_array_equal(played(DRIFTING)[1][-1], played(DRIFTING, beside=3)[1][-1])
    batch = EpisodeBatch(ARM, DRIFTING, num=2, threads=1)
    batch.start(0, seed=3, number=0)
    action = batch.actions.encode(levels=np.array([3, 3]), duration=0)
    batch.step([0], [action])
    batch.step([0], [action])
    batch.restore(1, copy.deepcopy(batch.episode(0)))
    batch.step([0, 1], [action, action])
    np.testing.assert_array_equal(batch.observe(0), batch.observe(1))


@pytest.mark.parametrize("name", ["joint_zero", "gain"])
def test_a_negative_drift_is_refused(name: str) -> None:
    with pytest.raises(InvalidSetting):
        Drift(**{name: -0.1})
