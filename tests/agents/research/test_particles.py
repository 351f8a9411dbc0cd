"""The posterior by particles names what is plain, repeats itself, and knows its own error."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from loose_agents.base import Problem
from loose_agents.research.particle_calibration import calibration_cases
from loose_agents.research.particle_check import (
    Weighed,
    by_size,
    compare,
    draw_check,
    play,
    probabilities_of,
)
from loose_agents.research.particle_posterior import ParticlePosterior, SimulatedRecords
from scipy.special import ndtr

from loose_env.arms import LinearArm, Mismatch, planar, vera
from loose_env.diagnosis import ParticleSettings, RecordStatistics, statistics_of, summaries_of
from loose_env.envs import DiagnosisSettings, Difficulty, EpisodeBatch, FaultSampler
from loose_env.excitation import at_levels
from loose_env.faults import Fault, Healthy

pytest.importorskip("numba")
from loose_env.rig import ReducedRig

FEW = ParticleSettings(particles=200, repeated=16, repeats=6, moves=1)
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
    tiny = ParticleSettings(particles=40, islands=2, steps=2, moves=1, repeated=4, repeats=3)
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
    """The same normals through a generator and through a particle give the same fault."""
    problem = Problem.of(vera(), DiagnosisSettings(engine="reduced"))
    sampler = FaultSampler(LinearArm(problem.arm), Difficulty())
    model = SimulatedRecords(problem, sampler, ReducedRig(problem.arm), [], seed=0)
    sizes = dict(zip(problem.hypotheses, model.variates, strict=True))
    assert sizes.pop("healthy") == 0  # nothing tells healthy arms apart but the mismatch
    assert set(sizes.values()) == {10}

    class Uniform:
        def random(self, size: int) -> np.ndarray:
            return ndtr(normals)

    normals = np.random.default_rng(4).standard_normal(10)
    for name in sizes:
        fault = model.fault(name, normals)
        assert fault == sampler.draw(Uniform(), hypothesis=name)  # type: ignore[arg-type]


def test_a_realisation_is_an_arm_of_its_own_and_the_first_is_nominal() -> None:
    problem = Problem.of(vera(), DiagnosisSettings(engine="reduced"))
    sampler = FaultSampler(LinearArm(problem.arm), Difficulty())
    model = SimulatedRecords(problem, sampler, ReducedRig(problem.arm), [], seed=0)
    assert (model.true_arm(0).mass == 1).all()
    assert np.array_equal(model.true_arm(3).mass, model.true_arm(3).mass)
    drawn = np.array([model.true_arm(k).mass[1:] for k in range(1, 200)])
    assert drawn.std() == pytest.approx(Mismatch().mass, rel=0.1)


def test_summaries_do_not_depend_on_which_joints_are_held(posterior: ParticlePosterior) -> None:
    record = record_of(posterior, Healthy(), joint=1)
    # Followed 2, commanded 2, its own, rms, variances 2, correlation, skewness 2, kurtosis 2 + 1.
    assert summaries_of(record).shape == (14,)
    assert np.isfinite(summaries_of(record)).all()


def test_summaries_stay_where_they_are_as_the_inertia_goes_through_infinity(
    posterior: ParticlePosterior,
) -> None:
    """A command that hardly shows in the joint's motion makes both ratios large, of any sign."""
    record = record_of(posterior, Healthy())
    plain, shown = summaries_of(record), []
    for factor in (1e5, 1e6, -1e6):
        shown.append(
            summaries_of(
                dataclasses.replace(
                    record,
                    inertia=factor * record.inertia,
                    transmission_by_instrument=factor * record.transmission_by_instrument,
                )
            )
        )
    assert shown[0] == pytest.approx(shown[2], abs=1e-3)
    assert shown[1][2:4] == pytest.approx(plain[2:4])  # the command's share in the tool's motion


def test_a_check_plays_compares_and_draws(tmp_path: Path) -> None:
    problem = Problem.of(planar(2), DiagnosisSettings(engine="reduced"))
    batch = EpisodeBatch(problem.arm, problem.settings, num=1, threads=1)
    played = [play(problem, batch, seed=5, number=k) for k in range(3)]
    assert [len(p.records) for p in played] == [1, 2, 3]
    again = play(problem, batch, seed=5, number=2)
    assert [len(p.statistics) for p in played] == [1, 2, 3]
    for read, shown in zip(played[2].statistics, played[2].records, strict=True):
        assert read.tool_covariance == pytest.approx(shown.tool_covariance, rel=1e-4)
    assert all(
        np.array_equal(a.tool_covariance, b.tool_covariance)
        for a, b in zip(again.records, played[2].records, strict=True)
    )
    prior = ParticlePosterior(problem)  # asked before any record, it costs nothing
    flat = np.array(
        [probabilities_of(problem, prior, dataclasses.replace(one, records=())) for one in played]
    )
    truth = np.array([one.truth for one in played])
    assert compare(flat, flat, truth).distance == 0
    path = tmp_path / "check.png"
    draw_check({"prior": flat}, flat, 0 * flat, truth, path, caption="nothing measured")
    assert path.stat().st_size > 10_000


def test_a_posterior_surer_than_the_particles_pays_in_the_log_score() -> None:
    particles = np.array([[0.7, 0.3]] * 10)
    truth = np.array([0] * 7 + [1] * 3)
    surer = compare(np.array([[0.99, 0.01]] * 10), particles, truth)
    assert surer.agreement == 1
    assert surer.score_gain < -0.3
    assert surer.distance == pytest.approx(0.29)
    assert surer.calibration == pytest.approx(0.29)
    assert surer.calibrated < 0.1


def test_stored_rows_give_probabilities_noise_and_distances() -> None:
    """Two runs of two islands: the runs' mean, half their spread, and what parts of them say."""
    log = np.log([[[1.0, 1.0], [1.0, 3.0]], [[1.0, 1.0], [1.0, 1.0]]])
    row = {"prior": [0.5, 0.5], "runs": [{"log_evidence": run.tolist()} for run in log]}
    weighed = Weighed.of([row])
    assert weighed.by_run(0) == pytest.approx(np.array([[1 / 3, 2 / 3]]))
    assert weighed.by_run(0, slice(0, 1)) == pytest.approx(np.array([[0.5, 0.5]]))
    assert weighed.probabilities == pytest.approx(np.array([[5 / 12, 7 / 12]]))
    assert weighed.standard_error == pytest.approx(np.array([[1 / 12, 1 / 12]]))
    even = np.array([[0.5, 0.5]])
    sizes = by_size(weighed, {"even": even}, np.array([1]))
    assert [at.share for at in sizes] == [0.5, 1.0, 2.0]
    assert [at.distance["even"] for at in sizes] == pytest.approx([0.0625, 1 / 12, 1 / 12])
    assert sizes[0].between == pytest.approx(0.125)
    assert sizes[1].between == pytest.approx(1 / 6)
    assert np.isnan(sizes[2].between)


def test_particles_are_calibrated_on_cases_of_their_own(posterior: ParticlePosterior) -> None:
    """The truth gets what the posterior promises, and more than the prior gives it."""
    record = record_of(posterior, Healthy())
    found = calibration_cases(
        posterior.problem,
        posterior.sampler,
        record,
        {},
        seed=1,
        cases=60,
        particles=60,
        repeated=16,
    )
    p = found.probabilities["particles"]
    assert p.sum(axis=1) == pytest.approx(1.0)
    given = p[np.arange(len(p)), found.truth]
    spread = np.std(given - (p**2).sum(axis=1)) / np.sqrt(len(p))
    assert abs(given.mean() - found.promised("particles")) < 3.5 * spread
    assert given.mean() > 0.5
