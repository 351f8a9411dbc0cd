"""Evidence by particles against cases whose evidence is known exactly."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import multivariate_normal

from loose_env.diagnosis.research.particles.evidence import (
    Evidence,
    ParticleSettings,
    evidence_by_particles,
)
from loose_env.diagnosis.research.particles.synthetic_likelihood import (
    Repeated,
    SyntheticLikelihood,
    nearness,
)
from loose_env.errors import InvalidData, InvalidSetting
from loose_env.typing import Array

NOISE = np.random.default_rng(7).standard_normal((4000, 3))
"""Noise of every numbered realisation, in standard deviations."""
NORMAL = ParticleSettings(particles=600, repeated=20, repeats=12, freedom=np.inf)


class LinearModel:
    """Summaries linear in the variates, with normal noise: everything is known in closed form."""

    prior = np.array([0.5, 0.3, 0.2])
    variates = (3, 8, 8)
    noise = np.array([0.1, 0.2, 0.15])

    def __init__(self, measured: Array) -> None:
        self.measured = measured
        rng = np.random.default_rng(5)
        self.slopes = [
            scale * rng.standard_normal((3, size))
            for scale, size in zip((0.3, 0.5, 0.8), self.variates, strict=True)
        ]
        self.offsets = (0.0, 0.7, -0.7)

    def simulate(self, hypothesis: int, variates: Array, realisations: NDArray[np.intp]) -> Array:
        means = self.offsets[hypothesis] + variates @ self.slopes[hypothesis].T
        return means + self.noise * NOISE[realisations]

    @property
    def exact(self) -> Array:
        logs = [
            multivariate_normal.logpdf(
                self.measured, np.full(3, offset), a @ a.T + np.diag(self.noise**2)
            )
            for offset, a in zip(self.offsets, self.slopes, strict=True)
        ]
        weights = self.prior * np.exp(np.array(logs) - max(logs))
        return np.asarray(weights / weights.sum())


def found(model: LinearModel, settings: ParticleSettings, seed: int = 0) -> Evidence:
    return evidence_by_particles(model, settings, np.random.default_rng(seed))


@pytest.mark.parametrize("case", range(4))
def test_probabilities_are_those_of_bayes_rule(case: int) -> None:
    model = LinearModel(np.random.default_rng(case).standard_normal(3))
    evidence = found(model, ParticleSettings(particles=4000, freedom=np.inf, repeats=16))
    assert evidence.probabilities == pytest.approx(model.exact, abs=0.08)
    assert evidence.interaction < 0.05  # the noise adds to all particles alike


def test_the_standard_error_falls_with_the_particles() -> None:
    model = LinearModel(np.array([0.4, -0.3, 0.5]))

    def error(particles: int) -> float:
        settings = ParticleSettings(particles=particles, repeated=10, repeats=8)
        errors = [found(model, settings, seed).standard_error.max() for seed in range(4)]
        return float(np.mean(errors))

    assert error(6400) < 0.6 * error(400)


def test_the_standard_error_is_of_the_size_of_the_error() -> None:
    model = LinearModel(np.array([0.4, -0.3, 0.5]))
    settings = ParticleSettings(particles=1200, repeated=20, repeats=8, freedom=np.inf)
    evidences = [found(model, settings, seed) for seed in range(12)]
    spread = np.std([e.probabilities[1] for e in evidences])
    said = np.mean([e.standard_error[1] for e in evidences])
    assert 0.4 < said / spread < 2.5


def test_a_hypothesis_far_off_is_left_early_with_a_bound() -> None:
    model = LinearModel(np.array([2.5, 2.0, 2.5]))
    model.slopes[0] = 0.05 * model.slopes[0]
    evidence = found(model, NORMAL)
    assert not evidence.finished[0]
    assert evidence.probabilities[0] < 2 * NORMAL.negligible


def test_a_hypothesis_without_prior_is_never_simulated() -> None:
    model = LinearModel(np.zeros(3))
    model.prior = np.array([0.5, 0.5, 0.0])
    model.variates = (3, 8, -1)  # would fail
    assert found(model, NORMAL).probabilities[2] == 0


def test_particles_that_fail_count_as_impossible() -> None:
    class Failing(LinearModel):
        def simulate(
            self, hypothesis: int, variates: Array, realisations: NDArray[np.intp]
        ) -> Array:
            shown = super().simulate(hypothesis, variates, realisations)
            shown[variates[:, 0] > 0] = np.nan
            return shown

    # Half of every hypothesis fails: the halves that are left decide, all lose alike.
    model, failing = LinearModel(np.zeros(3)), Failing(np.zeros(3))
    for one in (model, failing):
        for slopes in one.slopes:
            slopes[:, 0] = 0.0  # so that the variate that fails says nothing else
    many = ParticleSettings(particles=4000, freedom=np.inf, repeats=16)
    assert found(failing, many).probabilities == pytest.approx(model.exact, abs=0.08)


class SeatModel:
    """A sound arm, and a loose one that sticks for half of its variates and else strikes.

    One that strikes shows another mean, and scatters more the farther it is thrown.
    """

    prior = np.array([0.5, 0.5])
    variates = (0, 1)
    still = 0.1

    def __init__(self, measured: Array) -> None:
        self.measured = measured

    def simulate(self, hypothesis: int, variates: Array, realisations: NDArray[np.intp]) -> Array:
        thrown = np.maximum(variates[:, :1], 0.0) if hypothesis else np.zeros((len(variates), 1))
        return thrown + (self.still + 0.6 * thrown) * NOISE[realisations]

    @property
    def exact(self) -> Array:
        def density(thrown: float) -> float:
            width = (self.still + 0.6 * thrown) ** 2
            return float(multivariate_normal.pdf(self.measured, np.full(3, thrown), width))

        thrown = np.linspace(0.0, 6.0, 6001)
        weight = np.exp(-0.5 * thrown**2) / np.sqrt(2 * np.pi)
        strikes = float(np.sum([w * density(t) for w, t in zip(weight, thrown, strict=True)]))
        sound = density(0.0)
        loose = 0.5 * sound + strikes * (thrown[1] - thrown[0])
        return np.array([sound, loose]) / (sound + loose)


@pytest.mark.parametrize("thrown", [0.0, 0.2, 1.0])
def test_a_seat_that_sticks_scatters_as_a_sound_arm_does(thrown: float) -> None:
    """One covariance for all particles of the loose arm would rule out that it sticks."""
    rng = np.random.default_rng(3)
    settings = ParticleSettings(particles=800, freedom=np.inf, repeated=80)
    for _ in range(2):
        shown = thrown + (0.1 + 0.6 * thrown) * rng.standard_normal(3)
        model = SeatModel(shown)
        evidence = evidence_by_particles(model, settings, np.random.default_rng(0))
        assert evidence.probabilities == pytest.approx(model.exact, abs=0.12)


def test_probabilities_are_calibrated_on_cases_drawn_from_the_prior() -> None:
    """The exact posterior gives the truth, on average, the mean of its squares summed."""
    rng = np.random.default_rng(11)
    truth, given, promised = [], [], []
    for _ in range(40):
        h = int(rng.choice(3, p=LinearModel.prior))
        model = LinearModel(np.zeros(3))
        noise = model.noise * rng.standard_normal(3)
        model.measured = model.offsets[h] + model.slopes[h] @ rng.standard_normal(model.variates[h])
        model.measured = model.measured + noise
        settings = ParticleSettings(particles=800, repeated=40, freedom=np.inf)
        p = found(model, settings).probabilities
        truth.append(p[h])
        promised.append(float((p**2).sum()))
        given.append(float(abs(p - model.exact).sum() / 2))
    spread = float(np.std(np.subtract(truth, promised)) / np.sqrt(len(truth)))
    assert abs(np.mean(truth) - np.mean(promised)) < 3 * spread
    assert np.mean(given) < 0.1


def test_what_the_common_realisation_adds_is_taken_off() -> None:
    common = np.array([0.3, -0.2])
    rng = np.random.default_rng(0)
    repeated = [
        Repeated(common=mean + common, again=mean + 0.1 * rng.standard_normal((200, 2)))
        for mean in 0.05 * rng.standard_normal((6, 2))
    ]
    likelihood = SyntheticLikelihood.by_repeats(np.zeros(2), repeated, freedom=np.inf)
    shown = common + np.array([[0.0, 0.0], [0.1, 0.0], [0.0, 0.1], [np.nan, 0.0]])
    values = likelihood.log(shown)
    assert values[:3] - values[0] == pytest.approx([0.0, -0.5, -0.5], abs=0.15)
    assert values[0] == pytest.approx(-2 * np.log(0.1), abs=0.15)
    assert values[3] == -np.inf
    assert likelihood.interaction < 0.1


def test_what_is_far_apart_keeps_its_own_scatter() -> None:
    rng = np.random.default_rng(0)
    repeated = [
        Repeated(common=np.full(2, at), again=at + sd * rng.standard_normal((40, 2)))
        for at, sd in [(0.0, 0.1)] * 8 + [(20.0, 2.0)] * 8
    ]
    densities = [
        SyntheticLikelihood.by_repeats(np.full(2, at), repeated, freedom=np.inf).log(
            np.full((1, 2), at)
        )[0]
        for at in (0.0, 20.0)
    ]
    assert densities[0] - densities[1] == pytest.approx(2 * np.log(20.0), abs=0.5)


def test_too_few_particles_or_successes_are_refused_with_words() -> None:
    with pytest.raises(InvalidSetting, match="48 with 4 islands"):
        found(LinearModel(np.zeros(3)), ParticleSettings(particles=40))
    with pytest.raises(InvalidSetting, match="islands is a whole number"):
        ParticleSettings(islands=1)
    with pytest.raises(InvalidSetting, match="share"):
        ParticleSettings(share=1.0)
    with pytest.raises(InvalidData, match="all particles failed"):
        nearness(np.zeros(1), np.full((4, 1), np.nan))
    with pytest.raises(InvalidData, match="at least 2"):
        SyntheticLikelihood.by_repeats(
            np.zeros(1),
            [Repeated(common=np.zeros(1), again=np.zeros((3, 1)))],
            freedom=5,
        )
