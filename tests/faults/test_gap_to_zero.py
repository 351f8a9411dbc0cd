"""Shut the gap and stiffen the stops: what is left of a fault is a healthy arm.

Nothing but motion betrays a fault, so its place must become as unknown as it was before
anything was measured.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from math import ceil, sqrt

import numpy as np
import pytest

from loose_env.arms import Arm, LinearArm, Mismatch, MismatchDraw, planar, vera
from loose_env.diagnosis import FaultPosterior, RecordStatistics, statistics_of
from loose_env.envs import Difficulty, FaultSampler
from loose_env.excitation import Excitation, at_levels
from loose_env.faults import Backlash, Fault, Healthy, StructuralLooseness, hypotheses, place_of
from loose_env.rig import Job, SimulatedRig
from loose_env.sensors import SensorSuite
from loose_env.typing import Array

pytestmark = pytest.mark.slow

Loose = StructuralLooseness | Backlash

ARMS: dict[str, Callable[[], Arm]] = {"planar4": planar, "vera": vera}
# The narrowest that the default difficulty draws. An arm that meets its stops only now and
# then, in a wider gap, differs less from a healthy one than an arm that rattles.
FIRST_GAP = 0.02e-3
FACTORS = (1.0, 0.3, 0.1, 0.03, 0.01)
"""On the gap and on the compliance of the stops."""
POSES = ((0.4, -0.7, 0.9, 0.5), (-1.0, 1.4, -0.6, 1.2))
SAMPLES = 24
INTERVAL = 1.96
"""Half the sampling interval of a statistic, in standard deviations."""
FLOOR = 0.2
"""Below this the readings' own steps decide, in standard deviations."""


class Bench:
    """One true arm whose faults shut step by step."""

    def __init__(self, name: str) -> None:
        self.arm = arm = ARMS[name]()
        self.linear = LinearArm(arm)
        ranges = Difficulty(friction=(0.02, 0.02), gap=(FIRST_GAP, FIRST_GAP))
        sampler = FaultSampler(self.linear, ranges)
        self.places = hypotheses(arm)[1:]
        self.faults = [
            sampler.draw(np.random.default_rng(3), hypothesis=place) for place in self.places
        ]
        self.mismatch: MismatchDraw = Mismatch().draw(arm, np.random.default_rng(5))
        self.poses = [np.array(pose[: arm.n]) for pose in POSES]

    def shake(self, pose: Array, joint: int | None) -> Excitation:
        """One joint at the top level, or all of them."""
        on = np.ones(self.arm.n) if joint is None else np.arange(self.arm.n) == joint
        levels = self.arm.levels[-1] * on
        return at_levels(self.linear.at(pose), levels, duration=0.2)[0]

    def measured(
        self, pose: Array, arms: list[tuple[Fault, int]], finer: int = 1, joint: int | None = None
    ) -> list[RecordStatistics]:
        """Records of several arms, each a fault and the seed of its excitation and noise."""
        rig = SimulatedRig(self.arm, slots=len(arms), timestep=self.arm.timestep / finer, threads=2)
        for slot, (fault, _) in enumerate(arms):
            rig.mount(slot, fault, self.mismatch)
        jobs = [
            Job(
                slot=slot,
                pose=pose,
                excitation=self.shake(pose, joint),
                rng=np.random.default_rng(seed),
            )
            for slot, (_, seed) in enumerate(arms)
        ]
        return [statistics_of(m) for m in rig.measure_many(jobs)]

    def scatter(self, pose: Array) -> Array:
        """Standard deviation of every statistic of the healthy arm from record to record."""
        records = self.measured(pose, [(Healthy(), 100 + k) for k in range(SAMPLES)])
        return np.std([figures(r) for r in records], axis=0, ddof=1)

    def differences(self, pose: Array, faults: list[Fault], finer: int = 1) -> Array:
        """Faulty arms less the healthy one with the same excitation, noise and step."""
        healthy, *faulty = self.measured(
            pose, [(fault, 0) for fault in (Healthy(), *faults)], finer
        )
        return np.array([figures(record) - figures(healthy) for record in faulty])

    def diagnosed(self, factor: float) -> Array:
        """Probabilities of the hypotheses, for the healthy arm and every place.

        Two poses, the first and the last joint shaken in each.
        """
        faults: list[Fault] = [Healthy(), *(closed(fault, factor) for fault in self.faults)]
        posterior = FaultPosterior(self.linear, SensorSuite())
        beliefs = [posterior.start() for _ in faults]
        for k, pose in enumerate(self.poses):
            for joint in (0, self.arm.n - 1):
                arms = [(fault, k) for fault in faults]
                records = self.measured(pose, arms, ceil(1 / sqrt(factor)), joint)
                beliefs = [posterior.update(b, r) for b, r in zip(beliefs, records, strict=True)]
        return np.array([belief.probabilities for belief in beliefs])


@cache
def bench(name: str) -> Bench:
    return Bench(name)


def figures(record: RecordStatistics) -> Array:
    """All statistics of a record in a row."""
    on = record.excited
    rms = np.sqrt(np.diag(record.tool_covariance))
    direction = np.outer(record.lowest_direction, record.lowest_direction)
    return np.concatenate(
        [
            record.transmission[:, on].ravel(),
            record.transmission_by_instrument[:, on].ravel(),
            record.joint_rms[on],
            record.inertia[on],
            rms,
            (record.tool_covariance / np.outer(rms, rms))[np.triu_indices(len(rms), 1)],
            direction[np.triu_indices(len(rms))],
            [record.lowest_coherence, record.maximum_correlation],
            record.skewness,
            record.kurtosis,
            [record.lowest_skewness, record.lowest_kurtosis],
        ]
    )


def closed(fault: Fault, factor: float) -> Loose:
    """The fault with gap and compliance driven towards zero, as damped as before."""
    assert isinstance(fault, (StructuralLooseness, Backlash))
    low, high = (k / factor for k in fault.stiffness)
    damping = fault.damping
    return replace(
        fault,
        gap=fault.gap * factor,
        stiffness=(low, high),
        damping=(damping[0] / sqrt(factor), damping[1] / sqrt(factor)),
    )


@cache
def closing(name: str) -> Array:
    """Differences over scatter, (factors, poses, places, statistics)."""
    b = bench(name)
    rows = []
    for factor in FACTORS:
        faults: list[Fault] = [closed(fault, factor) for fault in b.faults]
        finer = ceil(1 / sqrt(factor))  # a stiffer stop needs a smaller step
        rows.append([b.differences(pose, faults, finer) / b.scatter(pose) for pose in b.poses])
    return np.array(rows)


@pytest.mark.parametrize("name", ARMS)
def test_as_the_gap_shuts_every_fault_fades_step_by_step(name: str) -> None:
    distance = np.sqrt(np.mean(closing(name) ** 2, axis=(1, 3)))
    for place, fading in zip(bench(name).places, distance.T, strict=True):
        less, lost = np.diff(fading) < 0, fading[1:] < FLOOR
        assert (less | lost).all(), f"{place}: {fading.round(3)}"
        assert fading[-1] < 0.1 * fading[0]


@pytest.mark.parametrize("name", ARMS)
def test_an_open_gap_shows_and_a_shut_one_is_lost_in_the_scatter(name: str) -> None:
    largest = np.abs(closing(name)).max(axis=(1, 3))
    for place, first, last in zip(bench(name).places, largest[0], largest[-1], strict=True):
        assert first > 3 * INTERVAL, place
        assert last < INTERVAL, place


@pytest.mark.parametrize("name", ARMS)
def test_the_diagnosis_finds_an_open_gap_and_of_a_shut_one_knows_nothing(name: str) -> None:
    b = bench(name)
    names = hypotheses(b.arm)
    prior = FaultPosterior(b.linear, SensorSuite()).start().probabilities
    np.testing.assert_allclose(prior, [1 / 3] + [1 / 3 / b.arm.n] * 2 * b.arm.n)

    open_gap = b.diagnosed(FACTORS[0])[1:]
    for place, probabilities in zip(b.places, open_gap, strict=True):
        assert probabilities[0] < 0.1, place
        assert place_of(names[int(np.argmax(probabilities))]) == place_of(place)

    shut = b.diagnosed(FACTORS[-1])
    assert (shut[:, 0] > 0.5).all()
    # Were there a fault after all, its place would be as unknown as in the healthy arm, where
    # only those places lose against the prior that would have shown.
    healthy, *others = shut[:, 1:] / shut[:, 1:].sum(axis=1, keepdims=True)
    for place, other in zip(b.places, others, strict=True):
        assert 0.5 * np.abs(other - healthy).sum() < 0.2, place


@pytest.mark.parametrize("name", ARMS)
def test_a_seat_that_sticks_shows_nowhere(name: str) -> None:
    b = bench(name)
    stuck: list[Fault] = [replace(closed(fault, 1.0), friction=1e4) for fault in b.faults]
    pose = b.poses[0]
    assert np.abs(b.differences(pose, stuck) / b.scatter(pose)).max() < 0.1 * INTERVAL
