"""The posterior over faults: what it must do whatever its accuracy, and a floor under that."""

from __future__ import annotations

import numpy as np
import pytest

from loose_env.arms import Arm, LinearArm, planar, vera
from loose_env.diagnosis.likelihood.opening_table import (
    PRESSES,
    RATIOS,
    OpeningTable,
    shipped_table,
)
from loose_env.diagnosis.likelihood.posterior import FaultPosterior, PosteriorSettings
from loose_env.diagnosis.likelihood.record_likelihood import LOOSE, OPENINGS
from loose_env.diagnosis.records.record_statistics import RecordStatistics, statistics_of
from loose_env.envs import Difficulty, FaultSampler
from loose_env.errors import InvalidData, InvalidSetting
from loose_env.excitation import at_levels
from loose_env.faults import Fault, Healthy
from loose_env.rig import Job, SimulatedRig
from loose_env.sensors import SensorSuite
from tests.diagnosis.likelihood.imagined import imagined_record


def records_of(
    arm: Arm, faults: list[Fault], count: int, seed: int, level: int = -1
) -> list[list[RecordStatistics]]:
    """Records of each arm in random poses, joint 1 shaken, mismatch on."""
    rng = np.random.default_rng(seed)
    rig, mismatch = SimulatedRig(arm, slots=len(faults)), Difficulty().mismatch
    for slot, fault in enumerate(faults):
        rig.mount(slot, fault, mismatch.draw(arm, rng))
    found: list[list[RecordStatistics]] = [[] for _ in faults]
    levels = np.zeros(arm.n)
    levels[0] = arm.levels[level]
    for _ in range(count):
        jobs = []
        for slot in range(len(faults)):
            pose = arm.random_pose(rng)
            excitation, _ = at_levels(rig.nominal.at(pose), levels, duration=1.2)
            jobs.append(Job(slot=slot, pose=pose, excitation=excitation, rng=rng.spawn(1)[0]))
        for slot, measurement in enumerate(rig.measure_many(jobs)):
            found[slot].append(statistics_of(measurement))
    return found


@pytest.fixture(scope="module")
def planar3() -> FaultPosterior:
    return FaultPosterior(LinearArm(planar(3)), SensorSuite())


@pytest.fixture(scope="module")
def drawn() -> tuple[list[Fault], list[list[RecordStatistics]]]:
    arm = planar(3)
    sampler = FaultSampler(LinearArm(arm), Difficulty())
    rng = np.random.default_rng(21)
    faults = [sampler.draw(rng) for _ in range(40)]
    return faults, records_of(arm, faults, 3, seed=22)


def test_it_names_most_faults_after_three_records(
    planar3: FaultPosterior, drawn: tuple[list[Fault], list[list[RecordStatistics]]]
) -> None:
    right, log_score = 0, 0.0
    for fault, records in zip(*drawn, strict=True):
        belief = planar3.start()
        for record in records:
            belief = planar3.update(belief, record)
        p = belief.probabilities
        assert p.sum() == pytest.approx(1.0)
        truth = planar3.hypotheses.index(fault.hypothesis)
        right += int(np.argmax(p) == truth)
        log_score += float(np.log(max(p[truth], 1e-12)))
    assert right >= 32  # of 40; blind guessing is right on about 13
    assert log_score / len(drawn[0]) > -0.7  # knowing only the prior scores -1.55


def test_the_order_of_records_does_not_matter(
    planar3: FaultPosterior, drawn: tuple[list[Fault], list[list[RecordStatistics]]]
) -> None:
    first, second, third = drawn[1][0]
    there, back = planar3.start(), planar3.start()
    for a, b in zip((first, second, third), (third, first, second), strict=True):
        there, back = planar3.update(there, a), planar3.update(back, b)
    assert there.probabilities == pytest.approx(back.probabilities, abs=1e-9)


@pytest.mark.parametrize("arm", [planar(3), vera()], ids=["planar3", "vera"])
def test_healthy_arms_are_called_healthy(arm: Arm) -> None:
    posterior = FaultPosterior(LinearArm(arm), SensorSuite())
    called = 0
    for records in records_of(arm, [Healthy()] * 16, 3, seed=5):
        belief = posterior.start()
        for record in records:
            belief = posterior.update(belief, record)
        called += int(np.argmax(belief.probabilities) == 0)
    assert called >= 12  # of 16


def test_a_seat_that_friction_keeps_shut_cannot_be_placed() -> None:
    arm = planar(3)
    stuck = (8.0, 12.0)
    sampler = FaultSampler(LinearArm(arm), Difficulty(friction=stuck))
    fault = sampler.draw(np.random.default_rng(1), hypothesis="structural_looseness@link2")
    (records,) = records_of(arm, [fault], 2, seed=3)
    posterior = FaultPosterior(LinearArm(arm), SensorSuite(), PosteriorSettings(friction=stuck))
    belief = posterior.start()
    for record in records:
        belief = posterior.update(belief, record)
    faulty = belief.probabilities[1:]
    assert faulty / faulty.sum() == pytest.approx(np.full(6, 1 / 6), abs=0.02)


def test_the_prior_follows_the_kinds_that_are_possible() -> None:
    only = PosteriorSettings(kinds={"healthy": 0.5, "structural_looseness": 0.5})
    p = FaultPosterior(LinearArm(planar(2)), SensorSuite(), only).start().probabilities
    assert p == pytest.approx([0.5, 0.25, 0.25, 0.0, 0.0])


def test_the_shipped_table_holds_distributions_that_open_as_the_drive_grows() -> None:
    table = shipped_table()
    for part in (table.slide, table.hinge):
        assert part.sum(axis=(2, 3)) == pytest.approx(np.ones(part.shape[:2]), abs=0.02)
        mean = np.einsum("hrsq,s->hr", part, OPENINGS)
        assert mean[:, :4] == pytest.approx(np.zeros((len(PRESSES), 4)))
        assert mean[0, 5:].max() > 0.15


def test_in_the_plane_it_says_what_the_shipped_policies_were_trained_on() -> None:
    linear = LinearArm(planar(3))
    posterior = FaultPosterior(linear, SensorSuite())
    belief = posterior.start()
    for pose, joint in (([0.3, -0.8, 1.1], 1), ([-0.5, 0.9, 0.4], 3)):
        record = imagined_record(
            linear, pose, joint=joint, link=2, direction=[0.6, 0.8], opening=0.25
        )
        belief = posterior.update(belief, record)
    # Worked out before the posterior knew arms in space.
    before = [0.79357400, 0.01812587, 0.09789506, 0.08996078, 3.86908748e-4, 3.76574608e-5]
    assert belief.probabilities[:6] == pytest.approx(before, rel=1e-6)
    assert belief.direction(2) == pytest.approx(np.radians(50.0))


@pytest.mark.parametrize(
    "wrong",
    [
        {"friction": (0.0, 1.0)},
        {"friction": (1.0, 0.5)},
        {"directions": 1},
        {"space_directions": 2},
        {"temper": 0.0},
    ],
)
def test_settings_that_make_no_sense_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(InvalidSetting):
        PosteriorSettings(**wrong)  # type: ignore[arg-type]


def test_a_table_of_another_shape_is_refused() -> None:
    good = np.ones((len(PRESSES), len(RATIOS), len(OPENINGS), len(LOOSE)))
    with pytest.raises(InvalidData, match="shape"):
        OpeningTable(slide=good, hinge=good[0])
