"""The observation without accelerometers."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest

import loose_env  # noqa: F401
from loose_env.errors import InvalidSetting
from loose_env.wrappers import JointSideObservation, MeasuredMinusNominal, PosteriorObservation

ARGUMENTS = {"n_links": 2, "engine": "reduced", "max_records": 2}


def names_of(env):
    """Elements of the flat observation."""
    layout = env.get_wrapper_attr("layout")
    records = [
        f"record{k + 1}.{each.name}" for k in range(layout.slots) for each in layout.slot_elements
    ]
    return [each.name for each in layout.global_elements] + records


def test_only_what_torque_and_encoders_give_is_left() -> None:
    env = JointSideObservation(gymnasium.make("loose_env/Planar-v0", **ARGUMENTS))
    seen, _ = env.reset(seed=0)
    assert env.observation_space.contains(seen)
    names = names_of(env)
    assert len(names) == len(seen)
    words = ("tool", "transmission", "coherence", "kurtosis", "skewness", "direction", "link")
    assert not [name for name in names if any(word in name for word in words)]
    assert {"record2.inertia.joint2", "record2.nominal_inertia.joint2"} <= set(names)
    whole = [element.name for element in env.unwrapped.layout.elements]
    assert {name for name in whole if name.startswith(("now", "spent"))} <= set(names)


def test_its_numbers_are_those_of_the_whole_observation() -> None:
    inner = gymnasium.make("loose_env/Planar-v0", **ARGUMENTS)
    env = JointSideObservation(inner)
    env.reset(seed=3)
    whole = [element.name for element in inner.unwrapped.layout.elements]
    action = inner.unwrapped.actions.encode(levels=np.full(2, 3), duration=0)
    seen, *_ = env.step(action)
    last, names = inner.unwrapped.batch.observe(0), names_of(env)
    for name, value in zip(names, seen, strict=True):
        assert value == last[whole.index(name)]
    assert seen[names.index("record1.inertia.joint1")] != 0


def test_it_is_made_anew_from_its_spec_and_takes_other_layouts() -> None:
    env = JointSideObservation(gymnasium.make("loose_env/Planar-v0", **ARGUMENTS))
    again = gymnasium.make(env.spec)
    assert again.observation_space == env.observation_space
    assert np.array_equal(again.reset(seed=1)[0], env.reset(seed=1)[0])
    difference = MeasuredMinusNominal(gymnasium.make("loose_env/Planar-v0", **ARGUMENTS))
    alone = JointSideObservation(difference)
    assert alone.observation_space.contains(alone.reset(seed=1)[0])
    assert not [name for name in names_of(alone) if "nominal" in name]
    with pytest.raises(InvalidSetting, match="inside the wrappers"):
        PosteriorObservation(env)


def test_raw_signals_are_refused() -> None:
    with pytest.raises(InvalidSetting, match="without raw=True"):
        JointSideObservation(gymnasium.make("loose_env/Planar-v0", raw=True, **ARGUMENTS))
