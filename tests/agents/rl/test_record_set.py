from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import gymnasium
import numpy as np
import pytest

from loose_env.errors import InvalidSetting

torch = pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")

from loose_agents.rl.end_to_end.joint_inference import (  # noqa: E402
    EpisodeStore,
    PosteriorPolicy,
    PosteriorSetExtractor,
)
from loose_agents.rl.end_to_end.record_set import (  # noqa: E402
    RecordSetExtractor,
    record_set_arguments,
)
from loose_agents.rl.set_network import LOG_SCALE  # noqa: E402

Env = gymnasium.Env[Any, Any]


@pytest.fixture(scope="module")
def env() -> Iterator[Env]:
    made = gymnasium.make("loose_env/Vera-v0").unwrapped
    yield made
    made.close()


def observations(layout: Any, records: int, *, seed: int = 0, batch: int = 5) -> Any:
    """Observations with so many measured records, of random elements."""
    rng = np.random.default_rng(seed)
    found = rng.normal(size=(batch, layout.size)).astype(np.float32)
    slots = found[:, len(layout.global_elements) :].reshape(batch, layout.slots, -1)
    slots[:, :records, 0] = 1.0
    slots[:, records:] = 0.0
    return torch.from_numpy(found)


def extractors(env: Any) -> list[Any]:
    given = record_set_arguments(env.layout)
    torch.manual_seed(0)
    return [
        RecordSetExtractor(env.observation_space, **given),
        PosteriorSetExtractor(env.observation_space, hypotheses=5, **given),
    ]


def test_order_of_records_and_empty_slots_do_not_matter(env: Any) -> None:
    layout, start = env.layout, len(env.layout.global_elements)
    seen = observations(layout, records=4)
    slots = seen[:, start:].reshape(len(seen), layout.slots, -1)
    order = torch.tensor([7, 2, 0, 9, 3, 1, 4, 5, 6, 8, 10, 11])
    mixed = torch.cat([seen[:, :start], slots[:, order].flatten(1)], 1)
    filled = slots.clone()
    filled[:, 4:, 1:] = 3.0  # elements of slots that are marked empty
    noise = torch.cat([seen[:, :start], filled.flatten(1)], 1)
    for network in extractors(env):
        network.standardise(seen.numpy())
        wanted = network(seen)
        assert wanted.shape == (5, network.features_dim)
        torch.testing.assert_close(network(mixed), wanted)
        torch.testing.assert_close(network(noise), wanted)
        fewer = observations(layout, records=3)
        assert not torch.allclose(network(fewer), wanted)


def test_without_records_only_the_global_elements_are_seen(env: Any) -> None:
    seen = observations(env.layout, records=0)
    network = extractors(env)[0]
    found = network(seen)
    torch.testing.assert_close(found[:, : network.start], seen[:, : network.start])
    assert not found[:, network.start :].any()


def test_constant_elements_weigh_nothing_and_stay_finite(env: Any) -> None:
    seen = observations(env.layout, records=2)
    network = extractors(env)[0]
    network.standardise(seen.numpy())
    assert network.gain[0] == 0.0  # the element that says that a record was measured
    assert torch.isfinite(network.gain).all()
    assert (network.gain[1:] > 0.0).all()


def test_pairs_are_statistics_and_their_nominal_twins(env: Any) -> None:
    names = [each.name for each in env.layout.slot_elements]
    pairs = record_set_arguments(env.layout)["pairs"]
    assert pairs
    assert all(names[b] == f"nominal_{names[a]}" for a, b in pairs)


def test_a_wrong_layout_is_refused_in_words(env: Any) -> None:
    with pytest.raises(InvalidSetting, match="record_set_arguments"):
        RecordSetExtractor(env.observation_space, slots=12, slot_size=1000)


def test_the_policy_does_not_train_the_posterior(env: Any) -> None:
    network = extractors(env)[1]
    seen = observations(env.layout, records=2)
    assert not network(seen).requires_grad
    network.loss(seen, torch.zeros(5, dtype=torch.int64)).backward()
    assert all(p.grad is not None for p in network.parameters())


def test_the_store_keeps_the_latest_episodes_and_cuts_them_after_first_records() -> None:
    store = EpisodeStore(3, 2 + 4 * 2)
    for k in range(5):
        episode = np.zeros(10, dtype=np.float32)
        episode[:2] = k
        episode[2 : 2 + 2 * 3] = k + 1.0  # three records of two elements
        store.add(episode[None], [k])
    rng = np.random.default_rng(0)
    found, truths = store.sample(200, rng, start=2, slot_size=2)
    found, truths = found.numpy(), truths.numpy()
    assert set(truths) == {2, 3, 4}
    assert (found[:, 0] == truths).all()
    slots = found[:, 2:].reshape(200, 4, 2)
    lengths = (slots[:, :, 0] != 0.0).sum(1)
    assert set(lengths) == {1, 2, 3}
    assert all(
        (slot[:n] == truth + 1.0).all()
        for slot, n, truth in zip(slots, lengths, truths, strict=True)
    )
    assert (store.observations[:, 2:8] != 0.0).all()  # the store itself stays as it was


def test_verdicts_start_as_the_expected_rewards_under_the_posterior(env: Any) -> None:
    torch.manual_seed(0)
    nvec = env.actions.nvec
    names = env.hypotheses
    rewards = [[1.0 if a == b else -1.0 for b in names] for a in names] + [[-0.25] * len(names)]
    policy = PosteriorPolicy(
        env.observation_space,
        env.action_space,
        lambda _: 1e-2,
        net_arch=[8],
        features_extractor_class=PosteriorSetExtractor,
        features_extractor_kwargs={**record_set_arguments(env.layout), "hypotheses": len(names)},
        verdict_rewards=rewards,
    )
    seen = observations(env.layout, records=2)

    def logits() -> Any:
        features = policy.extract_features(seen)
        return policy.action_net(policy.mlp_extractor.forward_actor(features))[:, -nvec[-1] :]

    with torch.no_grad():
        before = logits()
        logs = policy.extract_features(seen)[:, -len(names) :] / LOG_SCALE
    wanted = torch.exp(logs) @ torch.tensor(rewards).T / 0.2
    torch.testing.assert_close(before[:, 1:], wanted)
    torch.testing.assert_close(before[:, 0], torch.ones(5), atol=0.3, rtol=0.0)  # 0.2 / 0.2
