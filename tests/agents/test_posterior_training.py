"""Banks, figures and the training of the learned posterior, at a small size."""

from __future__ import annotations

import io
import re

import numpy as np
import pytest
import torch
from loose_agents.base import Problem
from loose_agents.posterior_training import PosteriorTraining, TrainingSettings
from loose_agents.record_bank import (
    BankPlan,
    BankSettings,
    build_bank,
    build_features,
    features_of_bank,
    play_episodes,
    read_bank,
    read_features,
)

from loose_env.arms import Mismatch, planar
from loose_env.diagnosis import AmortisedPosterior, SeatFeatures, SeatNetwork
from loose_env.envs import DiagnosisSettings
from loose_env.sensors import SensorSuite
from loose_env.statistics import axes_grid

DIRECTIONS = 8


@pytest.fixture(scope="module")
def problem():
    return Problem.of(planar(2), DiagnosisSettings(engine="reduced", durations=(0.2,)))


@pytest.fixture(scope="module")
def bank(problem):
    settings = BankSettings(records=2, long_every=0)
    return play_episodes(problem, settings, seed=3, start=0, stop=240, width=16)


@pytest.fixture(scope="module")
def features(problem):
    return SeatFeatures(problem.linear, SensorSuite(), Mismatch(), directions=DIRECTIONS)


@pytest.fixture(scope="module")
def figures(problem, bank, features):
    return features_of_bank(problem, features, bank)


def training(figures, **given):
    return PosteriorTraining(
        figures,
        joints=2,
        directions=axes_grid(DIRECTIONS, 2),
        friction=(0.02, 1.0),
        settings=TrainingSettings(**{"steps": 150, "batch": 48, "checkpoint": 50} | given),
    )


def test_episodes_do_not_depend_on_how_a_bank_is_cut(problem, bank):
    settings = BankSettings(records=2, long_every=0)
    alone = play_episodes(problem, settings, seed=3, start=17, stop=19, width=1)
    assert np.array_equal(alone.slots, bank.slots[17:19])
    assert np.array_equal(alone.truth, bank.truth[17:19])
    assert np.array_equal(alone.ratio, bank.ratio[17:19])


def test_every_truth_comes_up_and_its_figures_fit(problem, bank):
    assert set(bank.truth) == set(range(5))
    assert np.isinf(bank.ratio[bank.truth == 0]).all()
    slides = (bank.truth == 1) | (bank.truth == 2)
    assert np.allclose(np.linalg.norm(bank.direction[slides], axis=1), 1.0)
    # Friction is drawn between 0.02 and 1 times the drive.
    assert (bank.ratio[bank.truth > 0] >= 0.999).all()
    assert (bank.ratio[bank.truth > 0] <= 50.001).all()


def test_the_pass_in_numpy_is_that_of_torch(problem, bank, features, figures):
    made = training(figures, steps=20)
    made.train()
    posterior = AmortisedPosterior(
        problem.linear,
        SensorSuite(),
        Mismatch(),
        SeatNetwork(made.tensors()),
        directions=DIRECTIONS,
    )
    from loose_env.wrappers import record_from

    observation = np.zeros(problem.layout.size, dtype=np.float32)
    slots = problem.layout.slots_of(observation)
    for episode in range(5):
        slots[:2] = bank.slots[episode]
        belief = posterior.start()
        for k in range(2):
            belief = posterior.update(belief, record_from(problem.layout, observation, k))
            with torch.no_grad():
                log, _ = made.posterior(figures, figures.rows(np.array([episode]), 2), 2)
            # Figures are stored in half precision.
            assert np.allclose(belief.probabilities, np.exp(log[0, k].numpy()), atol=0.01)


@pytest.mark.slow
def test_training_learns_and_resumes_to_the_same_weights(figures, tmp_path):
    whole = training(figures)
    before = whole.scores(figures, most=2)[1]["score"]
    whole.train()
    after = whole.scores(figures, most=2)[1]["score"]
    assert after > before + 0.5
    first = training(figures)

    def stop(step, loss):
        if step == 100:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        first.train(tmp_path, stop)
    second, log = training(figures), io.StringIO()
    second.train(tmp_path, stream=log)
    # A log gets whole lines, from where the first one was stopped.
    lines = log.getvalue().splitlines()
    shares = [re.search(r"\d+/150", line) for line in lines]
    assert [share and share[0] for share in shares] == ["115/150", "130/150", "145/150", "150/150"]
    assert all(" loss " in line for line in lines)
    assert second.step == 150
    for name, tensor in whole.tensors().items():
        assert np.allclose(second.tensors()[name], tensor, atol=1e-6), name


def test_banks_on_disk_resume_and_read_back(tmp_path):
    plan = BankPlan(
        env_id="loose_env/Planar-v0",
        arguments={"engine": "reduced", "n_links": 2, "durations": [0.2], "max_records": 2},
        episodes=12,
        records=BankSettings(records=2, long_every=0),
        directions=6,
    )
    build_bank(plan, tmp_path)
    store = build_features(plan, tmp_path)
    bank = read_bank(plan, tmp_path)
    assert len(bank) == 12
    found = read_features(store, plan.shards)
    assert found.place.shape[:2] == (int((bank.slots[:, :, 0] > 0.5).sum()), 2 * 6 + 2)
    assert np.array_equal(found.truth, bank.truth)
