"""Sizes of what a model cannot have, learned from the data."""

from __future__ import annotations

import numpy as np
import pytest

from loose_env.instrument.inference.evidence import Evidence
from loose_env.instrument.inference.laplace_fit import fit_hypothesis
from loose_env.instrument.inference.variance_components import updated
from loose_env.instrument.pipeline import Workbench
from loose_env.instrument.settings.diagnosis import DiagnoseSettings
from tests.instrument.arms.blind_arm import runs, write_model


@pytest.fixture(scope="module")
def evidence(tmp_path_factory: pytest.TempPathFactory) -> Evidence:
    bench = Workbench(
        write_model(tmp_path_factory.mktemp("arm")), DiagnoseSettings(poses=2, seconds=1.0)
    )
    for run in runs("healthy"):
        bench.add(run)
    return Evidence(uncertain=bench.uncertain, lines=bench.suspect)


def test_steps_reach_the_variance_that_the_data_have() -> None:
    """Power of a normal residual of standard deviation 0.3 along one pattern of unit weight."""
    rng = np.random.default_rng(3)
    drawn = rng.normal(0.0, 0.3, 4000)
    variance = np.full(1, 4.0)
    for _ in range(60):
        weight = 1 / variance
        explained = np.sum((weight * drawn) ** 2, keepdims=True)
        variance = updated(variance, explained, weight * len(drawn))
    assert variance[0] == pytest.approx(0.09, rel=0.05)


def test_a_component_without_data_shrinks_to_its_bound(evidence: Evidence) -> None:
    index = evidence.index
    none = np.zeros(len(index.scales))
    found = index.within_bounds(index.updated(index.scales**2, none, none))
    factors = np.concatenate([index.bands(run) for run in (0, 1)])
    readings = [index.reading(change=change) for change in (False, True)]
    own = np.setdiff1d(np.arange(len(found)), [*factors, *readings])
    assert found[own] == pytest.approx((0.01 * index.scales[own]) ** 2)
    assert found[readings] == pytest.approx((index.scales[readings] / [3, 1]) ** 2)
    assert (found[factors] < 1).all()  # their prior has a mode below one


def test_what_changes_between_sessions_costs_more_than_a_wrong_model(evidence: Evidence) -> None:
    """A reading that is wrong by 60 %: a model may be, the same arm an hour later is not."""
    index = evidence.index
    costs = []
    for change in (False, True):
        wrong = index.start(0.01)
        usual = index.log_prior(wrong)
        wrong[index.reading(change=change)] = 0.6**2
        costs.append(usual - index.log_prior(wrong))
    assert costs[0] < 10 < 50 < costs[1]


def test_every_pattern_has_a_component_and_runs_share_all_but_the_joints(
    evidence: Evidence,
) -> None:
    index, n = evidence.index, evidence.uncertain.arm.n
    first, second = (index.columns(run, change=False) for run in (0, 1))
    assert len(first) == 8 * n
    assert not set(first[:n]) & set(second[:n])
    assert (first[n:] == second[n:]).all()
    changed = index.columns(0, change=True)
    assert not set(first) & set(changed)
    used = {*first, *second, *changed, *index.columns(1, change=True)}
    used |= {index.reading(change=False), index.reading(change=True)}
    used |= {*index.bands(0), *index.bands(1)}
    assert used == set(range(len(index.scales)))


def test_a_healthy_fit_leaves_little_of_the_motion(evidence: Evidence) -> None:
    fit = fit_hypothesis(evidence, "healthy", None)
    assert max(term.misfit for term in fit.runs.values()) < 0.01
    assert fit.evidence < sum(term.log_likelihood for term in fit.runs.values())


def test_a_motion_beside_the_model_is_learned_for_its_own_joint_and_run(
    evidence: Evidence,
) -> None:
    """Motion that the drive does not make raises the error of its joint alone."""
    n = evidence.uncertain.arm.n
    before = fit_hypothesis(evidence, "healthy", None)
    rng = np.random.default_rng(5)
    run, joint = 0, int(evidence.lines[0].excited[0])
    piece = evidence.pieces(before.errors, before.variances)[run]
    omega2 = (2 * np.pi * piece.lines.frequency) ** 2
    acceleration = (
        0.5
        * omega2
        * np.abs(piece.response.motion[:, joint])
        * np.exp(2j * np.pi * rng.random(len(omega2)))
    )
    moved = piece.response.joint_columns()[:, :, joint] * acceleration[:, None]
    one = evidence.lines[run]
    disturbed = Evidence(
        uncertain=evidence.uncertain,
        lines=[
            type(one)(**{**vars(one), "readings": one.readings + moved}),
            *evidence.lines[1:],
        ],
    )
    after = fit_hypothesis(disturbed, "healthy", None)
    own = disturbed.index.columns(run, change=False)[joint]
    other = disturbed.index.columns(1, change=False)[:n]
    assert np.sqrt(after.variances[own]) > 0.2
    assert np.sqrt(before.variances[own]) < 0.1
    assert np.sqrt(after.variances[other]).max() < 0.1
