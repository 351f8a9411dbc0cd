"""Training on loose_env/Gap-v0 goes on where it stopped, and its agent plays episodes."""

from pathlib import Path

import numpy as np
import pytest
from loose_agents.policies.model_gap import LearnedGapAgent

from loose_env.envs import GapObservation, ModelGapEnv, ModelGapSettings
from loose_env.errors import InvalidSetting
from loose_env.gap import BeliefSettings
from scripts.model_gap.train import Options, train
from tests.gap.experiment_design.small_bank import small_bank, small_models


def test_training_goes_on_and_its_agent_plays(tmp_path: Path) -> None:
    settings = ModelGapSettings(belief=BeliefSettings(simulations=0), max_motions=2)
    env = ModelGapEnv(small_bank(), settings, models=small_models())

    for steps in (16, 24):  # the second one goes on
        train(Options(out=tmp_path, steps=steps, every=8), env)

    curve = (tmp_path / "curve.csv").read_text().splitlines()
    assert curve[0] == "steps,episodes,reward,success,seconds"
    assert [row.split(",")[0] for row in curve[1:]] == ["8", "16", "24"]
    agent = LearnedGapAgent(tmp_path / "policy.pt", env.layout, most=2)
    observation, info = env.reset(seed=1)
    state, start, over = None, True, False
    while not over:
        action, state = agent.predict(observation, state, np.array([start]))
        assert info["action_mask"][int(action)]
        observation, _, over, _, info = env.step(action)
        start = False
    assert "is_success" in info

    other = GapObservation(candidates=4, motions=2, ranks=5)
    with pytest.raises(InvalidSetting, match="train anew on this library"):
        LearnedGapAgent(tmp_path / "policy.pt", other, most=2)
    with pytest.raises(InvalidSetting, match="no weights"):
        LearnedGapAgent(tmp_path / "none.zip", env.layout, most=2)
