"""The observation without accelerometers."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest

import loose_env  # noqa: F401
from loose_env.envs import JointSideObservation
from loose_env.errors import InvalidSetting

ARGUMENTS = {"n_links": 2, "engine": "reduced", "max_records": 2}


def test_only_what_torque_and_encoders_give_is_left() -> None:
    env = JointSideObservation(gymnasium.make("loose_env/Planar-v0", **ARGUMENTS))
    seen, _ = env.reset(seed=0)
    assert env.observation_space.contains(seen)
    words = ("tool", "transmission", "coherence", "kurtosis", "skewness", "direction", "link")
    assert not [name for name in env.names if any(word in name for word in words)]
    assert {"record2.inertia.joint2", "record2.nominal_inertia.joint2"} <= set(env.names)
    whole = [element.name for element in env.unwrapped.layout.elements]
    assert {name for name in whole if name.startswith(("now", "spent"))} <= set(env.names)


def test_its_numbers_are_those_of_the_whole_observation() -> None:
    inner = gymnasium.make("loose_env/Planar-v0", **ARGUMENTS)
    env = JointSideObservation(inner)
    env.reset(seed=3)
    whole = [element.name for element in inner.unwrapped.layout.elements]
    action = inner.unwrapped.actions.encode(levels=np.full(2, 3), duration=0)
    seen, *_ = env.step(action)
    last = inner.unwrapped.batch.observe(0)
    for name, value in zip(env.names, seen, strict=True):
        assert value == last[whole.index(name)]
    assert seen[env.names.index("record1.inertia.joint1")] != 0


def test_raw_signals_are_refused() -> None:
    with pytest.raises(InvalidSetting, match="set raw=False"):
        JointSideObservation(gymnasium.make("loose_env/Planar-v0", raw=True, **ARGUMENTS))
