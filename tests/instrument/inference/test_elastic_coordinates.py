"""Elastic gears, links and base of the uncertain arm."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from loose_env.instrument.inference.evidence import Evidence
from loose_env.instrument.inference.laplace_fit import fit_hypothesis
from loose_env.instrument.inference.response.frequency_response import respond
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


def errors_with(evidence: Evidence, name: str, value: float, others: float = 8.0) -> np.ndarray:
    """Parameters with one stiffness, the others so high that nothing gives."""
    uncertain = evidence.uncertain
    errors = np.zeros(evidence.count)
    errors[uncertain.stiffnesses][: uncertain.elastic.count] = others
    errors[uncertain.names.index(name)] = value
    return errors


def test_every_gear_link_and_the_base_have_springs(evidence: Evidence) -> None:
    elastic = evidence.uncertain.elastic
    names, joints = elastic.names, evidence.uncertain.arm.joints
    assert elastic.count == 3 * len(joints) + 5
    assert len(names) == elastic.count + len(joints) + 4  # pairs of bendings, slides and rockings
    assert {f"gear_stiffness@{joint}" for joint in joints} < set(names)
    assert (evidence.uncertain.elastic.stiffness > 0).all()


def test_the_slope_of_a_stiffness_is_that_of_the_readings(evidence: Evidence) -> None:
    line = evidence.lines[0]
    at = evidence.uncertain.at(line.pose)
    rng = np.random.default_rng(4)
    errors = 0.3 * rng.normal(size=evidence.count)
    no_seat = np.zeros((len(line.frequency), 7 * evidence.uncertain.arm.n), dtype=complex)
    slopes = respond(at, line, errors).slopes(no_seat)
    for name in evidence.uncertain.elastic.names:
        k = evidence.uncertain.names.index(name)
        step = np.zeros_like(errors)
        step[k] = 1e-5
        up, down = respond(at, line, errors + step).mean, respond(at, line, errors - step).mean
        found = (up - down) / 2e-5
        assert slopes[:, :, k] == pytest.approx(found, abs=1e-3 * np.abs(found).max() + 1e-12)


def test_a_spring_answers_as_a_mass_on_it(evidence: Evidence) -> None:
    """The last gear's tip motion grows by 1 / (1 - (f / f0)²) where the joint is held fast.

    With the joint's drive blocked by a huge stiffness, only the gear lets the last link turn.
    """
    uncertain = evidence.uncertain
    last = uncertain.arm.joints[-1]
    errors = errors_with(evidence, f"gear_stiffness@{last}", -2.0)
    line = next(one for one in evidence.lines)
    at = uncertain.at(line.pose)
    column = len(uncertain.moving) + len(uncertain.arm.joints) - 1
    own = at.nominal.inertia[column, column]
    gear = len(uncertain.arm.joints) - 1
    stiffness = at.elastic_stiffness(errors)[gear, gear]
    compliance = respond(at, line, errors).compliance[:, column, column]
    # Between a spring with the link alone and one that moves the rest of the arm too.
    omega2 = (2 * np.pi * line.frequency) ** 2
    alone = 1 / (stiffness - omega2 * own)
    low = line.frequency < 0.3 * np.sqrt(stiffness.real / own) / (2 * np.pi)
    assert low.any()
    assert compliance[low] == pytest.approx(alone[low], rel=0.1)


def test_a_soft_gear_is_found_by_the_runs_of_all_poses(evidence: Evidence) -> None:
    """Readings of an arm with one soft gear are explained by it, and by no fault."""
    uncertain = evidence.uncertain
    name = f"gear_stiffness@{uncertain.arm.joints[1]}"
    soft = errors_with(evidence, name, -3.0, others=1.0)
    lines = []
    for one in evidence.lines:
        truth = respond(uncertain.at(one.pose), one, soft).mean
        lines.append(dataclasses.replace(one, readings=truth))
    known = Evidence(uncertain=uncertain, lines=lines)
    fit = fit_hypothesis(known, "healthy", None, steps=25)
    assert fit.errors[uncertain.names.index(name)] == pytest.approx(-3.0, abs=0.5)


def test_a_link_is_soft_in_a_direction_of_its_own(evidence: Evidence) -> None:
    """A matrix that bends about one oblique axis alone is reached; turned axes change nothing."""
    elastic = evidence.uncertain.elastic
    one = elastic.names.index(f"bending_stiffness_1@{evidence.uncertain.arm.links[-1]}")
    both = [one, one + 1]
    pair = elastic.names.index(f"{elastic.names[one]}_{one + 1}")
    soft, angle = np.array([1.0, np.tan(0.4)]) * np.cos(0.4), 0.4
    wanted = np.eye(2) * 3.0 - 6.0 * np.outer(soft, soft)  # logarithm over the median
    parameters = np.zeros(len(elastic.names))
    parameters[both] = np.diag(wanted)
    parameters[pair] = wanted[0, 1] * np.sqrt(2)
    root = np.sqrt(elastic.stiffness[both])
    found = elastic.matrix(parameters)[np.ix_(both, both)] / np.outer(root, root)
    values, vectors = np.linalg.eigh(found)
    assert np.log(values) == pytest.approx([-3.0, 3.0])
    assert abs(vectors[:, 0] @ [np.cos(angle), np.sin(angle)]) == pytest.approx(1.0)
    assert np.sum(parameters**2) == pytest.approx(2 * 3.0**2)  # as likely as along the axes
