"""Banks, and the training of the learned posterior; agents that see what it was not made for."""

from __future__ import annotations

import io
import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from loose_agents.base import Problem
from loose_agents.belief import BeliefAgent, Sure
from loose_agents.benchmark.episodes import OFF, OtherArmRig
from loose_agents.jobs import BackendSettings
from loose_agents.policies.choice import RandomPolicy
from loose_agents.posterior_training import (
    NoveltySettings,
    PosteriorTraining,
    TrainingSettings,
    fit_reference,
    with_reference,
)
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

from loose_env.arms import Mismatch, MismatchDraw, planar
from loose_env.diagnosis import (
    LOCATION_FEATURES,
    RECORD_FEATURES,
    AmortisedPosterior,
    NoveltyReference,
    SeatFeatures,
    SeatNetwork,
    Seen,
)
from loose_env.diagnosis.features import TransmissionChange
from loose_env.envs import DiagnosisSettings, EnvBatch
from loose_env.faults import UNSURE, Healthy
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
    here = BackendSettings(backend="threading", workers=1)
    build_bank(plan, tmp_path, here)
    store = build_features(plan, tmp_path, here)
    bank = read_bank(plan, tmp_path)
    assert len(bank) == 12
    found = read_features(store, plan.shards)
    assert found.place.shape[:2] == (int((bank.slots[:, :, 0] > 0.5).sum()), 2 * 6 + 2)
    assert np.array_equal(found.truth, bank.truth)


JOINTS, SIX = 2, 6
PLACES = JOINTS * SIX + JOINTS
SIZES = {"C": len(LOCATION_FEATURES), "Q": len(RECORD_FEATURES), "W": 8, "H": 2 * JOINTS}
SIZES |= {"F": 3, "R": 4}


class _Estimator:
    """Says what it is told to."""

    def __init__(self, problem: Problem, probabilities: np.ndarray, surprise: float) -> None:
        self.problem, self.probabilities, self.surprise = problem, probabilities, surprise

    def begin(self) -> Any:
        return SimpleNamespace(belief=SimpleNamespace(surprise=self.surprise))

    def follow(self, observations: np.ndarray, memories: Any) -> np.ndarray:
        return np.tile(self.probabilities, (len(observations), 1))


@pytest.fixture(scope="module")
def tensors() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    made = {
        name: rng.normal(0, 0.3, [SIZES[x] for x in letters])
        for name, letters in SeatNetwork.shapes.items()
    }
    made |= {"place_scale": np.ones(SIZES["C"]), "record_scale": np.ones(SIZES["Q"])}
    return made | {"temper": np.zeros(SIZES["R"])}


def episodes(
    rng: np.random.Generator, count: int, *, records: int = 3, size: float = 1.0
) -> list[list[Seen]]:
    """Episodes of records with a change that no place explains, of some size."""

    def one() -> Seen:
        return Seen(
            rng.uniform(0.1, 1.0, (PLACES, SIZES["C"])),
            rng.normal(size=SIZES["Q"]),
            TransmissionChange(
                measured=size * rng.normal(size=4),
                open=rng.normal(size=(PLACES, 4)),
                nominal=np.ones(4),
                covariance=np.eye(4),
            ),
        )

    return [[one() for _ in range(records)] for _ in range(count)]


def verdict(problem: Problem, probabilities: np.ndarray, surprise: float, **options: float) -> str:
    agent = BeliefAgent(
        problem,
        _Estimator(problem, probabilities, surprise),
        RandomPolicy(problem),
        Sure(probability=0.0),
        **options,  # type: ignore[arg-type]
    )
    batch = EnvBatch(problem.arm, problem.settings, num=1, threads=1)
    batch.start(0, seed=1, number=0)
    for _ in range(problem.settings.unsure_after):  # "unsure" counts from then on
        batch.step([0], [problem.actions.encode(levels=np.array([1, 0]))])
    action, _ = agent.predict(batch.observe(0))
    return str(batch.step([0], [action]).info(0)["verdict"])


def test_an_agent_that_is_surprised_or_knows_nothing_names_nothing(problem: Problem) -> None:
    count = len(problem.hypotheses)
    certain = np.eye(count)[2]
    assert verdict(problem, certain, 0.0005) == UNSURE
    assert verdict(problem, certain, 0.5) == problem.hypotheses[2]
    assert verdict(problem, certain, 0.0005, surprising=0.0) == problem.hypotheses[2]
    assert verdict(problem, np.full(count, 1 / count), 1.0) == UNSURE


@pytest.mark.slow
def test_episodes_of_the_trained_kind_do_not_surprise_and_others_do(
    tensors: dict[str, np.ndarray],
) -> None:
    rng = np.random.default_rng(1)
    reference = fit_reference(
        tensors,
        episodes(rng, 150),
        episodes(rng, 200),
        directions=axes_grid(SIX, 2),
        settings=NoveltySettings(components=1),
    )
    assert [len(scores) for scores in reference.scores] == [200, 200, 200]
    stored = with_reference(tensors | {"reference.old": np.zeros(1)}, reference)
    assert "reference.old" not in stored
    assert all(stored[name] is values for name, values in tensors.items())
    problem = Problem.of(planar(JOINTS), DiagnosisSettings())

    def posterior(reference: NoveltyReference | None) -> AmortisedPosterior:
        return AmortisedPosterior(
            problem.linear,
            SensorSuite(),
            Mismatch(),
            SeatNetwork(tensors),
            directions=SIX,
            reference=reference,
        )

    def surprises(played: list[list[Seen]], one: AmortisedPosterior) -> np.ndarray:
        found = []
        for seen in played:
            belief = one.start()
            assert belief.surprise == 1.0
            for each in seen:
                belief = one.with_seen(belief, each)
            found.append(belief.surprise)
        return np.array(found)

    known = surprises(episodes(rng, 150), posterior(reference))
    assert np.mean(known < 0.1) == pytest.approx(0.1, abs=0.1)
    assert np.mean(known < 0.5) == pytest.approx(0.5, abs=0.18)
    far = episodes(rng, 10, size=30.0)
    assert (surprises(far, posterior(reference)) == 1 / 201).all()
    assert (surprises(far, posterior(None)) == 1.0).all()


def test_another_arm_is_off_in_every_length_and_mass_and_the_same_each_time() -> None:
    draws: list[MismatchDraw] = []
    rig: Any = SimpleNamespace(
        arm=planar(2), mount_all=lambda slots, faults, own: draws.extend(own)
    )
    draw = Mismatch().draw(planar(2), np.random.default_rng(3))
    other = OtherArmRig(rig)
    for _ in range(2):
        other.mount_all(np.array([0]), [Healthy()], [draw])
    first, second = draws
    for name in ("length", "mass"):
        factor = getattr(first, name) / getattr(draw, name)
        assert np.abs(factor - 1) == pytest.approx(OFF)
        assert np.array_equal(getattr(first, name), getattr(second, name))
    assert np.array_equal(first.sensor, draw.sensor)
