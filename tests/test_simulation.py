"""The prior and the batched simulator: what they draw, show and refuse."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest

import loose_env
from loose_env.errors import InvalidSetting

SHORT: dict[str, Any] = {"n_links": 2, "durations": (0.1,), "engine": "mujoco", "threads": 1}
STILL = np.array([0.3, 0.8, 0, 3, 0])
"""A pose; joint 2 at level 3; the only length."""


def test_records_are_those_of_the_environment_whatever_the_batch() -> None:
    prior, simulate = loose_env.simulator("loose_env/Planar-v0", num_envs=3, **SHORT)
    _, at_once = loose_env.simulator("loose_env/Planar-v0", num_envs=7, **SHORT)
    theta = prior.sample(np.random.default_rng(1), 7)
    found = simulate(theta, np.tile(STILL, (7, 1)), np.random.default_rng(2))
    several = at_once(theta[:3], np.tile(STILL, (3, 2, 1)), np.random.default_rng(2))
    np.testing.assert_array_equal(several[:, 0], found[:3])
    assert not np.array_equal(several[:, 1], several[:, 0])  # another draw of the same arm
    layout = gymnasium.make_vec("loose_env/Planar-v0", 1, **SHORT).unwrapped.layout  # type: ignore[attr-defined]
    names = [element.name for element in layout.slot_elements]
    assert (found[:, names.index("valid")] == 1).all()
    np.testing.assert_allclose(found[:, names.index("sin_pose.joint2")], np.sin(0.8), atol=1e-6)


def test_a_loose_link_shows_and_the_prior_knows_its_bounds() -> None:
    prior, simulate = loose_env.simulator("loose_env/Planar-v0", **SHORT)
    np.testing.assert_allclose(prior.probabilities, np.array([2, 1, 1, 1, 1]) / 6)  # of each kind
    theta = prior.sample(np.random.default_rng(0), 200)
    assert np.isfinite(prior.log_prob(theta)).all()
    outside = theta.copy()
    outside[:, 1] *= 1e3
    assert np.isneginf(prior.log_prob(outside)).all()
    density = np.exp(prior.log_prob(theta))
    # The mean of 1/p over draws is the volume of the support, here times hypotheses.
    volume = np.prod(prior.high - prior.low) * len(prior.hypotheses)
    assert np.mean(1 / density) == pytest.approx(volume, rel=0.3)
    assert len(prior.names) == theta.shape[1]
    both = np.repeat(theta[:1], 2, axis=0)
    both[:, 0] = [prior.hypotheses.index(n) for n in ("healthy", "structural_looseness@link2")]
    both[:, 1:3] = 4e-4, 0.02
    healthy, loose = simulate(both, np.tile(STILL, (2, 1)), np.random.default_rng(0))
    assert np.abs(healthy - loose).max() > 0.1


@pytest.mark.parametrize(
    ("theta", "design", "words"),
    [
        (np.zeros((2, 3)), np.tile(STILL, (2, 1)), "theta is"),
        (-np.ones((2, 9)), np.tile(STILL, (2, 1)), "contact_damping_high are zero or more, got -1"),
        (np.ones((2, 9)), np.tile(STILL, (3, 1)), "a design is"),
        (np.ones((2, 9)), np.tile(STILL, (2, 40, 1)), "12 records at most"),
    ],
)
def test_what_does_not_fit_is_refused(theta: Any, design: Any, words: str) -> None:
    prior, simulate = loose_env.simulator("loose_env/Planar-v0", **SHORT)
    with pytest.raises(InvalidSetting, match=words):
        simulate(theta, design, np.random.default_rng(0))
    with pytest.raises(InvalidSetting, match="a Generator; got 0"):
        simulate(theta, design, 0)  # type: ignore[arg-type]
    with pytest.raises(InvalidSetting, match="count is a whole number"):
        prior.sample(np.random.default_rng(0), -1)
    for other in ("loose_env/Gap-v0", "CartPole-v1"):
        with pytest.raises(InvalidSetting, match="hides no fault of an arm"):
            loose_env.simulator(other)
