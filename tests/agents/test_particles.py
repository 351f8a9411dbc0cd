"""The posterior by particles names what is plain, repeats itself, and knows its own error."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from agents.base import Problem
from agents.particle_check import compare, draw_check, play, probabilities_of
from agents.particles import ParticlePosterior, SimulatedRecords
from loose_env.arms import planar, vera
from loose_env.arms.linear import LinearArm
from loose_env.arms.mismatch import Mismatch
from loose_env.diagnosis.particles import ParticleSettings
from loose_env.diagnosis.record import RecordStatistics, statistics_of
from loose_env.diagnosis.synthetic_likelihood import summaries_of
from loose_env.envs.difficulty import Difficulty, FaultSampler
from loose_env.envs.episode import EpisodeBatch
from loose_env.envs.settings import DiagnosisSettings
from loose_env.excitation import at_levels
from loose_env.faults import Fault, Healthy

pytest.importorskip("numba")
from loose_env.rig.reduced import ReducedRig

FEW = ParticleSettings(particles=200, repeated=6, repeats=4, moves=1)
POSE = np.array([0.3, 1.2])
LOOSE = Difficulty(friction=(0.02, 0.1), gap=(0.1e-3, 0.4e-3))


@pytest.fixture(scope="module")
def posterior() -> ParticlePosterior:
    problem = Problem.of(planar(2), DiagnosisSettings(engine="reduced", difficulty=LOOSE))
    return ParticlePosterior(problem, FEW)


def record_of(
    posterior: ParticlePosterior, fault: Fault, joint: int = 0, seed: int = 3
) -> RecordStatistics:
    """One short record of an arm with default mismatch, one joint shaken at the top level."""
    problem = posterior.problem
    rig = ReducedRig(problem.arm)
    rig.mount(0, fault, Mismatch().draw(problem.arm, np.random.default_rng(seed)))
    levels = np.where(np.arange(problem.arm.n) == joint, problem.arm.levels[-1], 0.0)
    shake, _ = at_levels(problem.linear.at(POSE), levels, duration=0.2)
    return statistics_of(rig.measure(POSE, shake, rng=np.random.default_rng(seed)))


@pytest.mark.parametrize("hypothesis", ["structural_looseness@link2", "healthy"])
def test_a_plain_state_is_named(posterior: ParticlePosterior, hypothesis: str) -> None:
    fault = posterior.sampler.draw(np.random.default_rng(2), hypothesis=hypothesis)
    evidence = posterior.evidence([record_of(posterior, fault)])
    named = posterior.hypotheses[int(evidence.probabilities.argmax())]
    assert named == hypothesis
    assert evidence.probabilities.max() > 0.6
    assert evidence.probabilities.sum() == pytest.approx(1.0)
    assert (evidence.standard_error >= 0).all()


def test_the_same_seed_gives_the_same_probabilities(posterior: ParticlePosterior) -> None:
    record = record_of(posterior, Healthy())
    tiny = ParticleSettings(particles=40, islands=2, steps=2, moves=1, repeated=3, repeats=3)
    found = [
        ParticlePosterior(posterior.problem, tiny, seed=seed, sampler=posterior.sampler)
        .evidence([record])
        .probabilities
        for seed in (1, 1, 2)
    ]
    assert found[0].tolist() == found[1].tolist()
    assert found[0].tolist() != found[2].tolist()


def test_without_a_record_the_prior_comes_out(posterior: ParticlePosterior) -> None:
    evidence = posterior.start().evidence
    assert evidence.probabilities == pytest.approx([1 / 3, 1 / 6, 1 / 6, 1 / 6, 1 / 6])
    assert evidence.standard_error.max() == 0
    assert evidence.simulations == 0


def test_particles_are_the_environments_own_draws() -> None:
    """The same normals through a generator and through the particles give the same arm."""
    problem = Problem.of(vera(), DiagnosisSettings(engine="reduced"))
    sampler = FaultSampler(LinearArm(problem.arm), Difficulty())
    rig = ReducedRig(problem.arm)
    model = SimulatedRecords(problem, sampler, rig, [], seed=0)
    name = "structural_looseness@link1"
    size = model.variates[problem.hypotheses.index(name)]
    normals = np.random.default_rng(4).standard_normal(size)
    mismatch, fault = model.draw(name, normals)
    drawn = Mismatch().draw(problem.arm, np.random.default_rng(4))
    for key, value in vars(drawn).items():
        assert np.array_equal(getattr(mismatch, key), value), key
    assert fault.hypothesis == name
    low, high = Difficulty().gap
    assert low <= fault.gap <= high  # type: ignore[union-attr]
    # A draw takes as many variates whatever the hypothesis.
    assert set(model.variates) == {size}


def test_summaries_do_not_depend_on_which_joints_are_held(posterior: ParticlePosterior) -> None:
    record = record_of(posterior, Healthy(), joint=1)
    # Transmission 2, rms, inertia, variances 2, correlation, kurtosis 2, lowest kurtosis.
    assert summaries_of(record).shape == (10,)
    assert np.isfinite(summaries_of(record)).all()


def test_a_check_plays_compares_and_draws(tmp_path: Path) -> None:
    problem = Problem.of(planar(2), DiagnosisSettings(engine="reduced"))
    batch = EpisodeBatch(problem.arm, problem.settings, num=1, threads=1)
    played = [play(problem, batch, seed=5, number=k) for k in range(3)]
    assert [len(p.records) for p in played] == [1, 2, 3]
    again = play(problem, batch, seed=5, number=2)
    assert all(
        np.array_equal(a.tool_covariance, b.tool_covariance)
        for a, b in zip(again.records, played[2].records, strict=True)
    )
    prior = ParticlePosterior(problem)  # asked before any record, it costs nothing
    flat = np.array(
        [probabilities_of(problem, prior, dataclasses.replace(one, records=())) for one in played]
    )
    truth = np.array([one.truth for one in played])
    assert compare(flat, flat, truth).difference == 0
    path = tmp_path / "check.png"
    draw_check({"prior": flat}, flat, 0 * flat, truth, path, caption="nothing measured")
    assert path.stat().st_size > 10_000


def test_a_posterior_surer_than_the_particles_pays_in_the_log_score() -> None:
    particles = np.array([[0.7, 0.3]] * 10)
    truth = np.array([0] * 7 + [1] * 3)
    surer = compare(np.array([[0.99, 0.01]] * 10), particles, truth)
    assert surer.agreement == 1
    assert surer.score_gain < -0.3
    assert surer.difference == pytest.approx(0.29)
