"""Neural ratio estimation with sbi, on records that tell the fault by construction."""

from __future__ import annotations

import sys
from dataclasses import asdict

import numpy as np
import pytest
from loose_agents.base import Problem
from loose_agents.core.ratio_posterior import FORMAT, RatioPosterior, RatioSettings, ratio_network
from loose_agents.posterior_training.ratio_training import (
    RatioTraining,
    episode_parts,
    train_ratio,
)
from loose_agents.record_bank import RecordBank

from loose_env.arms import planar
from loose_env.diagnosis import write_network
from loose_env.envs import DiagnosisSettings
from loose_env.errors import InvalidData, MissingExtra

SMALL = RatioSettings(hidden=24, features=12)


@pytest.fixture(scope="module")
def problem():
    return Problem.of(planar(2), DiagnosisSettings())


def bank_of(problem, episodes, seed):
    """Each record shows its fault in one element, twice as large as the noise."""
    rng = np.random.default_rng(seed)
    count, elements = len(problem.hypotheses), len(problem.layout.slot_elements)
    truth = rng.integers(count, size=episodes)
    slots = rng.normal(0.0, 0.5, (episodes, 3, elements)).astype(np.float32)
    slots[:, :, 0] = 1.0
    slots[np.arange(episodes), :, 1 + truth] += 1.0
    slots[: episodes // 2, 2] = 0.0  # half of the episodes have two records
    none = np.zeros(episodes)
    return RecordBank(
        slots=slots, truth=truth, direction=np.zeros((episodes, 3)), gap=none, friction=none,
        ratio=none,
    )  # fmt: skip


def test_beginnings_of_episodes_end_where_the_records_do(problem):
    bank = bank_of(problem, 10, 0)
    slots, truth = episode_parts(bank, 5)
    assert slots.shape[1] == 5
    assert not slots[:, 3:].any()
    assert len(slots) == 10 + 10 + 5
    taken = (slots[:, :, 0] > 0.5).sum(axis=1)
    assert np.bincount(taken).tolist() == [0, 10, 10, 5]
    assert np.array_equal(slots[20:, :3], bank.slots[5:])
    assert np.array_equal(truth[20:], bank.truth[5:])


def test_it_learns_and_more_records_say_more(problem, tmp_path):
    pytest.importorskip("sbi")
    network = train_ratio(
        problem,
        bank_of(problem, 3000, 1),
        SMALL,
        RatioTraining(epochs=12, batch=100, learning_rate=2e-3),
    )
    posterior = RatioPosterior(problem, network)
    slots, truth = episode_parts(bank_of(problem, 1000, 2), problem.layout.slots)
    taken = (slots[:, :, 0] > 0.5).sum(axis=1)
    p = posterior.probabilities(slots)
    assert p.sum(axis=1) == pytest.approx(1.0)
    right = p.argmax(axis=1) == truth
    one, three = right[taken == 1].mean(), right[taken == 3].mean()
    # by Bayes' rule 0.80 and 0.98 for five hypotheses two noise deviations apart
    assert one > 0.55
    assert three > max(one, 0.75)
    turned = slots[:20][:, ::-1]
    assert posterior.probabilities(turned) == pytest.approx(p[:20], abs=1e-5)

    tensors = {name: value.numpy() for name, value in network.state_dict().items()}
    configuration = {
        "format": FORMAT, "fingerprint": problem.fingerprint, "network": asdict(SMALL),
    }  # fmt: skip
    write_network(tmp_path, configuration, tensors)
    again = RatioPosterior.load(tmp_path, problem)
    observation = np.zeros(problem.layout.size, dtype=np.float32)
    problem.layout.slots_of(observation)[:] = slots[0]
    assert again.follow(observation, again.begin()) == pytest.approx(p[0], abs=1e-6)
    other = Problem.of(planar(3), DiagnosisSettings())
    with pytest.raises(InvalidData, match="other observations"):
        RatioPosterior.load(tmp_path, other)
    broken = {name: np.full_like(values, np.nan) for name, values in tensors.items()}
    write_network(tmp_path, configuration, broken)
    with pytest.raises(InvalidData, match="not finite"):
        RatioPosterior.load(tmp_path, problem)
    write_network(tmp_path, configuration | {"network": {"hidden": 7}}, tensors)
    with pytest.raises(InvalidData, match="does not say hidden, features"):
        RatioPosterior.load(tmp_path, problem)
    write_network(tmp_path, configuration | {"network": {"hidden": 7, "features": 5}}, tensors)
    with pytest.raises(InvalidData, match="other layers"):
        RatioPosterior.load(tmp_path, problem)


def test_without_sbi_a_line_says_what_to_install(problem, monkeypatch):
    monkeypatch.setitem(sys.modules, "sbi.neural_nets", None)
    with pytest.raises(MissingExtra, match=r"pip install -e '\.\[sbi\]'"):
        ratio_network(problem, SMALL)
