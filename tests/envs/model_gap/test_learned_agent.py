"""Training on loose_env/Gap-v0 goes on where it stopped, and its agent plays episodes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from gymnasium import spaces
from loose_agents.rl.motion_policy import LearnedGapAgent, MotionPolicy

from loose_env.envs import GapObservation, ModelGapEnv, ModelGapSettings
from loose_env.errors import InvalidSetting
from loose_env.gap import BeliefSettings
from scripts.model_gap.train import Options, train
from tests.gap.experiment_design.small_bank import small_bank, small_models

SHIPPED = Path(__file__).parents[3] / "agents/loose_agents/weights/gap-ppo/policy.pt"


def test_training_goes_on_and_its_agent_plays(tmp_path: Path) -> None:
    settings = ModelGapSettings(belief=BeliefSettings(simulations=0), max_motions=2)
    env = ModelGapEnv(small_bank(), settings, models=small_models())

    for steps in (16, 24):  # the second one goes on
        train(Options(out=tmp_path, steps=steps, every=8), env)

    curve = (tmp_path / "curve.csv").read_text().splitlines()
    assert curve[0] == "steps,episodes,reward,success,seconds"
    assert [row.split(",")[0] for row in curve[1:]] == ["8", "16", "24"]
    agent = LearnedGapAgent(tmp_path / "policy.pt", env)
    observation, info = env.reset(seed=1)
    state, start, over = None, True, False
    while not over:
        action, state = agent.predict(observation, state, np.array([start]))
        assert info["action_mask"][int(action)]
        observation, _, over, _, info = env.step(action)
        start = False
    assert "is_success" in info

    other = ModelGapEnv(env.bank, replace(settings, ranks=3), models=env.models)
    with pytest.raises(InvalidSetting, match="as many ranks of verdicts: train anew"):
        LearnedGapAgent(tmp_path / "policy.pt", other)
    for damaged in (b"", SHIPPED.read_bytes()[:5000]):
        (tmp_path / "cut.pt").write_bytes(damaged)
        with pytest.raises(InvalidSetting, match="is damaged"):
            LearnedGapAgent(tmp_path / "cut.pt", env)
    stored = torch.load(SHIPPED, weights_only=True)
    stored["policy"]["mlp_extractor.scale"][0] = float("nan")
    torch.save(stored, tmp_path / "nan.pt")
    with pytest.raises(InvalidSetting, match="not finite"):
        LearnedGapAgent(tmp_path / "nan.pt", env)
    with pytest.raises(InvalidSetting, match="no weights"):
        LearnedGapAgent(tmp_path / "none.zip", env)


def observations(layout: GapObservation, count: int) -> np.ndarray:
    """Beliefs after a motion, of random numbers."""
    rng = np.random.default_rng(3)
    found = rng.uniform(0.0, 0.3, (count, layout.size)).astype(np.float32)
    found[:, layout.sets] = np.log10(rng.dirichlet(np.ones(layout.ranks), count))
    found[:, layout.taken.start] = 1.0
    return found


def policy_of(layout: GapObservation, seconds: np.ndarray, prices: np.ndarray) -> MotionPolicy:
    torch.manual_seed(0)
    actions = spaces.Discrete(layout.motions + layout.ranks)
    return MotionPolicy(
        layout.space, actions, lambda _: 1e-3, layout=layout, seconds=seconds, prices=prices
    )


def test_the_first_policy_takes_the_motion_of_the_largest_expected_reward() -> None:
    layout = GapObservation(candidates=3, motions=4, ranks=5)
    prices = np.array([0.02, 0.05, 0.01, 0.2])
    policy = policy_of(layout, np.ones(4), prices)
    seen = observations(layout, 50)

    logits = policy.mlp_extractor.forward_actor(torch.from_numpy(seen)).detach().numpy()

    worth = seen[:, layout.gain] - prices + 1e-3 * seen[:, layout.information]
    assert (logits[:, :4].argmax(1) == worth.argmax(1)).all()
    assert (logits[:, 4:].argmax(1) == seen[:, layout.sets].argmax(1)).all()


def test_scores_follow_a_motion_to_another_place() -> None:
    layout = GapObservation(candidates=3, motions=4, ranks=5)
    seconds, prices = np.array([1.0, 2.0, 3.0, 9.0]), np.array([0.01, 0.02, 0.03, 0.09])
    order, seen = np.array([2, 0, 3, 1]), observations(layout, 8)
    moved = seen.copy()
    for part in (layout.taken, layout.rest, layout.information, layout.gain):
        moved[:, part] = seen[:, part][:, order]
    first, second = (
        policy_of(layout, seconds[which], prices[which]) for which in (np.arange(4), order)
    )
    for network in (first.mlp_extractor.motion, second.mlp_extractor.motion):
        torch.nn.init.normal_(network[-1].weight, generator=torch.Generator().manual_seed(1))

    one, other = (
        policy.mlp_extractor.forward_actor(torch.from_numpy(given)).detach().numpy()
        for policy, given in ((first, seen), (second, moved))
    )

    assert np.allclose(one[:, :4][:, order], other[:, :4], atol=1e-5)
    assert np.allclose(one[:, 4:], other[:, 4:], atol=1e-5)


def test_shipped_weights_serve_another_library() -> None:
    settings = ModelGapSettings(belief=BeliefSettings(simulations=0))
    env = ModelGapEnv(small_bank(), settings, models=small_models())
    agent = LearnedGapAgent(SHIPPED, env)
    rewards = []
    for seed in range(6):
        observation, _ = env.reset(seed=seed)
        state, start, over, total = None, True, False, 0.0
        while not over:
            action, state = agent.predict(observation, state, np.array([start]))
            observation, reward, over, _, _ = env.step(action)
            start, total = False, total + reward
        rewards.append(total)
    assert np.mean(rewards) > 0.5
