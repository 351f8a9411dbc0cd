"""The oracle: told direction and friction, and nothing of where the fault is."""

from __future__ import annotations

import numpy as np
import pytest
from loose_agents.base import Problem
from loose_agents.belief import Tracker
from loose_agents.evaluation import evaluate
from loose_agents.policies.oracle import OracleAgent, Told, oracle_agent, restricted
from loose_agents.registry import belief_agent
from scipy import stats

from loose_env.arms import Arm, planar, six_axis
from loose_env.diagnosis import FaultPosterior, PosteriorSettings
from loose_env.envs import DiagnosisSettings, FaultSampler
from loose_env.faults import Backlash, Healthy, StructuralLooseness

SETTINGS = DiagnosisSettings(durations=(0.2,), max_records=3, engine="reduced")


def oracle_of(problem: Problem, **settings: int) -> OracleAgent:
    """An oracle with the analytic posterior, which needs no training."""
    made = oracle_agent(problem, estimator="posterior", policy="together", seed=1)
    if settings:
        posterior = FaultPosterior(
            problem.linear, problem.settings.sensors, PosteriorSettings(**settings)
        )
        made = OracleAgent(problem, Tracker(problem, posterior), made.policy, made.stopping)
    return made


@pytest.fixture(scope="module")
def problem() -> Problem:
    pytest.importorskip("numba")
    return Problem.of(planar(2), SETTINGS)


@pytest.fixture(scope="module")
def oracle(problem: Problem) -> OracleAgent:
    return oracle_of(problem)


def test_what_is_told_says_nothing_about_the_hypothesis(
    problem: Problem, oracle: OracleAgent
) -> None:
    prior = oracle.estimator.begin().belief.probabilities
    for direction, friction in ((0, 0), (7, 3), (17, 7)):
        memory = oracle._posterior.start(Told(direction=direction, friction=friction))
        assert memory.probabilities == pytest.approx(prior)


def test_only_what_agrees_with_it_is_left(oracle: OracleAgent) -> None:
    told = Told(direction=5, friction=2)
    before = oracle._posterior.base.start()
    after = restricted(before, told)
    open_ = np.isfinite(after.loose).any(0)
    count = len(before.directions)
    assert open_.sum() == 2 + 2  # a slide of each link, a play in each joint
    assert open_[[5, count + 5, 2 * count, 2 * count + 1], 2].all()
    assert after.by_direction(1)[5] == pytest.approx(1.0)


@pytest.mark.parametrize("arm", [planar(2), six_axis()], ids=lambda arm: arm.name)
def test_it_is_told_the_nearest_of_the_true_figures(arm: Arm) -> None:
    pytest.importorskip("numba")
    problem = Problem.of(arm, SETTINGS)
    oracle = oracle_of(problem, directions=36, space_directions=100, frictions=8)
    base = oracle._posterior.base
    sampler = FaultSampler(problem.linear, oracle._sampler.difficulty)
    rng = np.random.default_rng(2)
    for _ in range(5):
        slide = sampler.draw(rng, hypothesis=f"structural_looseness@link{arm.n}")
        assert isinstance(slide, StructuralLooseness)
        told = oracle.told(slide, rng)
        u = np.array(slide.direction)[: base.directions.shape[1]]
        cosines = np.abs(base.directions @ u)
        assert cosines[told.direction] == cosines.max() > np.cos(np.radians(15.0))
        share = slide.friction / sampler.drive.slide(arm.n, slide.direction)
        steps = np.log(base.frictions[1] / base.frictions[0])
        assert abs(np.log(base.frictions[told.friction] / share)) <= 0.5 * steps + 1e-9
        play = sampler.draw(rng, hypothesis="backlash@joint1")
        assert isinstance(play, Backlash)
        share = play.friction / sampler.drive.hinge(1)
        node = base.frictions[oracle.told(play, rng).friction]
        assert abs(np.log(node / share)) <= 0.5 * steps + 1e-9


def test_a_healthy_arm_is_told_figures_like_any_other(oracle: OracleAgent) -> None:
    rng, sampler = np.random.default_rng(3), oracle._sampler
    slides = ["structural_looseness@link1", "structural_looseness@link2"]
    plays = ["backlash@joint1", "backlash@joint2"]
    groups = [
        [oracle.told(Healthy(), rng) for _ in range(60)],
        [oracle.told(sampler.draw(rng, hypothesis=h), rng) for h in slides * 30],
        [oracle.told(sampler.draw(rng, hypothesis=h), rng) for h in plays * 30],
    ]
    for name, per_bin, bins in (("direction", 3, 6), ("friction", 1, 8)):
        counts = [
            np.bincount([getattr(t, name) // per_bin for t in some], minlength=bins)
            for some in groups
        ]
        assert stats.chi2_contingency(counts).pvalue > 0.01
        assert min(map(min, counts)) > 0  # everything comes up in every group


def test_the_evaluator_tells_it(problem: Problem, oracle: OracleAgent) -> None:
    rows = evaluate(oracle, "oracle", problem.arm, SETTINGS, episodes=6, seed=4, threads=1)
    narrow = evaluate(oracle, "oracle", problem.arm, SETTINGS, episodes=6, seed=4, width=2)
    assert rows == narrow
    untold = belief_agent("posterior", "together", problem, seed=1)
    others = evaluate(untold, "untold", problem.arm, SETTINGS, episodes=6, seed=4, threads=1)
    assert [r.truth for r in rows] == [r.truth for r in others]
    # The same first record, of which it makes something else.
    assert [r.trail_price[0] for r in rows] == [r.trail_price[0] for r in others]
    assert [r.trail_truth[0] for r in rows] != [r.trail_truth[0] for r in others]
