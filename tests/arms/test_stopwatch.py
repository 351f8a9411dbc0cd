"""Simulations without MuJoCo's stopwatch: the same motion, still timers, the clock put back."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from loose_env.arms import quiet

MODEL = """
<mujoco>
  <option integrator="RK4"/>
  <worldbody>
    <body><joint name="a" axis="0 1 0" frictionloss="0.1"/><geom size="0.1" pos="0.3 0 0"/></body>
  </worldbody>
</mujoco>
"""


def fallen(steps: int = 200) -> mujoco.MjData:
    """A pendulum that falls."""
    model = mujoco.MjModel.from_xml_string(MODEL)
    data = mujoco.MjData(model)
    for _ in range(steps):
        mujoco.mj_step(model, data)
    return data


def seconds_timed(data: mujoco.MjData) -> float:
    """What the engine believes its steps to have taken."""
    return float(data.timer[mujoco.mjtTimer.mjTIMER_STEP].duration)


def test_the_motion_is_the_same_to_the_last_bit() -> None:
    timed = fallen()
    with quiet(), quiet():
        untimed = fallen()
    assert timed.qpos[0] != 0.0
    assert np.array_equal(timed.qpos, untimed.qpos)
    assert np.array_equal(timed.qacc, untimed.qacc)
    assert seconds_timed(timed) > 0.0
    assert seconds_timed(untimed) == 0.0
    with pytest.raises(ZeroDivisionError), quiet():
        raise ZeroDivisionError
    assert seconds_timed(fallen()) > 0.0
