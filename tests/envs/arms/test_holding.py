"""Every environment with its joints on brakes, on servos and behind elastic gears."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest

from loose_env.registration import IDS


@pytest.mark.parametrize("hold", ["servo", "compliant"])
@pytest.mark.parametrize("env_id", IDS)
def test_every_id_takes_the_softer_holdings(env_id: str, hold: str) -> None:
    env = gymnasium.make(env_id, hold=hold, disable_env_checker=True)
    arm = env.unwrapped.arm  # type: ignore[attr-defined]
    assert arm.hold == hold
    assert arm.name.endswith(f"-{hold}")
    assert bool(arm.gear_joints) == (hold == "compliant")
    observation, _ = env.reset(seed=3)
    env.action_space.seed(3)
    for _ in range(2):
        observation, _, terminated, truncated, info = env.step(env.action_space.sample())
        assert "failure" not in info or info["failure"] is None
        for value in observation.values() if isinstance(observation, dict) else [observation]:
            assert np.isfinite(np.asarray(value, dtype=float)).all()
        if terminated or truncated:
            break
    env.close()
