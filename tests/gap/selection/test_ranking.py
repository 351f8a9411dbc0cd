"""What was tried is listed whole, weighed by independent readings, and held against each member."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from loose_env.gap.data.aligned_run import Channel, Trial
from loose_env.gap.fitting.gauss_newton import Fit
from loose_env.gap.fitting.holdout_score import ScoredFit, improvement_of
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.effects.catalogue import CATALOGUE
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.output.result import EffectLocation
from loose_env.gap.residuals.autocorrelation import independent_rows
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.gap.selection.forward_selection import Selection
from loose_env.gap.selection.ranking import bic, indistinct, ranking_of
from tests.gap.cases.effect_arms import PLANAR
from tests.gap.cases.gap_case import nominal_structure

MACHINE = NominalModel(mujoco.MjSpec.from_string(PLANAR))
NOMINAL = nominal_structure(MACHINE)
COUNT, RATE = 4000, 100.0


def comparison() -> ResidualModel:
    """Two runs of one channel, which are never simulated."""
    time = np.arange(COUNT) / RATE
    trials = [
        Trial(
            name=f"run-{k}.csv", form="forward", time=time, measured=np.zeros((COUNT, 1)),
            step=1 / RATE, steps=COUNT, controls=np.zeros((COUNT, 3)), position=np.zeros(3),
            speed=np.zeros(3), resting=True,
        )
        for k in range(2)
    ]  # fmt: skip
    return ResidualModel(MACHINE, trials, (Channel("sensor.encoder1"),), np.ones(1), threads=1)


COMPARED = comparison()


def scored(effects: list[Effect], level: float, seed: int) -> ScoredFit:
    """A hypothesis that leaves white noise of this size."""
    rng = np.random.default_rng(seed)
    structure = NOMINAL.with_effects(effects)
    residual, held = level * rng.normal(size=(2, len(COMPARED)))
    free = np.zeros(len(structure.parameters))
    fitted = Fit(
        structure=structure, free=free, residual=residual,
        jacobian=np.zeros((0, len(free))), cost=float(residual @ residual),
    )  # fmt: skip
    blocks = [COMPARED.by_block(r**2) for r in (held, residual)]
    noise = COMPARED.by_block(np.ones(len(COMPARED)))
    return ScoredFit(
        fitted=fitted, held_out_residual=held, held_out_blocks=blocks[0], training_blocks=blocks[1],
        held_out_noise=noise, training_noise=noise,
        held_out_products=np.tile(blocks[0] - blocks[0].min(), (3, 1)) + level**2,
        training_products=np.tile(blocks[1] - blocks[1].min(), (3, 1)) + level**2,
        channel_products=np.ones((2, 1)),
    )  # fmt: skip


def at(kind: str, *where: str) -> list[Effect]:
    return [CATALOGUE[kind](MACHINE, each) for each in where]


GAINS = at("actuator_gain", "servo1", "servo2", "servo3")
SPRINGS = at("joint_spring", "joint1", "joint2", "joint3")
LATE = at("command_delay", "all")


def searched(*rivals: ScoredFit) -> Selection:
    base = scored([], 3.0, 0)
    named = Selection(base=base, steps=[rivals[0]])
    named.rivals = [[(each, improvement_of(each, base)) for each in rivals]]
    return named


def test_a_family_is_one_rival_with_all_its_places() -> None:
    named = searched(scored(GAINS, 1.0, 1), scored(LATE, 2.0, 2))
    first, second = ranking_of(named, COMPARED, COMPARED)
    assert (first.kind, first.where) == ("actuator_gain", "servo1")
    assert first.together_with == tuple(
        EffectLocation(kind="actuator_gain", where=where) for where in ("servo2", "servo3")
    )
    assert [place.where for place in first.places] == ["servo1", "servo2", "servo3"]
    assert (second.kind, second.where, second.together_with) == ("command_delay", "all", ())
    assert first.bic < second.bic < 0


def test_every_member_of_a_family_is_held_against_a_rival_family_at_its_joint() -> None:
    named = searched(scored(GAINS, 1.0, 1), scored(SPRINGS, 1.0, 2), scored(LATE, 2.5, 3))
    for gain, spring in zip(GAINS, SPRINGS, strict=True):
        assert [e.key for e in indistinct(named, gain)] == [spring.key]


def test_every_member_is_held_against_a_single_rival_that_explains_as_much() -> None:
    named = searched(scored(GAINS, 1.0, 1), scored(LATE, 1.0, 2))
    assert all([e.key for e in indistinct(named, gain)] == [LATE[0].key] for gain in GAINS)


def test_a_rival_that_has_the_effect_too_or_explains_less_is_no_alternative() -> None:
    fewer = scored([*GAINS[:2], *SPRINGS[2:]], 1.0, 2)
    named = searched(scored(GAINS, 1.0, 1), fewer, scored(LATE, 2.0, 3))
    assert indistinct(named, GAINS[0]) == ()
    assert [e.key for e in indistinct(named, GAINS[2])] == [SPRINGS[2].key]


def test_effects_of_later_steps_are_held_against_the_rivals_of_their_own_step() -> None:
    named = searched(scored(GAINS, 2.0, 1), scored(SPRINGS, 2.0, 2))
    second = scored([*GAINS, *LATE], 1.0, 4)
    other = scored([*GAINS, *SPRINGS[:1]], 1.0, 5)
    named.steps.append(second)
    named.rivals.append([(each, improvement_of(each, named.steps[0])) for each in (second, other)])
    assert [e.key for e in indistinct(named, LATE[0])] == [SPRINGS[0].key]
    assert [e.key for e in indistinct(named, GAINS[0])] == [SPRINGS[0].key]


def test_an_effect_that_was_swapped_in_is_held_against_what_it_replaced() -> None:
    named = searched(scored(GAINS, 1.0, 1))
    # the step that found nothing more: what it tried stands beside no accepted hypothesis
    failed = scored([*GAINS, *SPRINGS[1:2]], 1.0, 3)
    named.rivals.append([(failed, improvement_of(failed, named.steps[0]))])
    named.swapped = scored([*GAINS[1:], *SPRINGS[:1]], 1.0, 2)
    assert named.best is named.swapped
    assert [e.key for e in indistinct(named, SPRINGS[0])] == [GAINS[0].key]
    assert indistinct(named, GAINS[1]) == ()
    named.swapped = scored([*GAINS[1:], *SPRINGS[:1]], 0.5, 2)  # clearly better than before
    assert indistinct(named, SPRINGS[0]) == ()


def cells(blocks: int, width: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    return np.repeat(np.arange(blocks), width), np.zeros(blocks * width, dtype=np.intp)


@pytest.mark.parametrize("copies", [1, 10, 100])
def test_rows_that_repeat_each_other_count_once(copies: int) -> None:
    """Reading everything several times over tells nothing new, and changes no criterion."""
    rng = np.random.default_rng(5)
    before, after = 1.5 * rng.normal(size=300), rng.normal(size=300)
    count = independent_rows(np.repeat(after, copies), *cells(300, copies))
    assert count == pytest.approx(300)
    gained = copies * float(before @ before - after @ after) * count / (300 * copies)
    once = bic(float(before @ before - after @ after), parameters=2, count=300)
    assert bic(gained, parameters=2, count=count) == pytest.approx(once)


def test_a_needless_parameter_does_not_pay_however_many_rows_hang_together() -> None:
    rng = np.random.default_rng(7)
    block, channel = cells(100, 100)
    slow = np.sin(2 * np.pi * 7 * np.arange(10000) / 10000)
    slow /= np.linalg.norm(slow)
    taken, by_rows = 0, 0
    for _ in range(200):
        residual = np.repeat(rng.normal(size=100), 100)
        after = residual - slow * (slow @ residual)
        gained = float(residual @ residual - after @ after)
        count = independent_rows(after, block, channel)
        taken += bic(gained * count / 10000, parameters=1, count=count) < 0
        by_rows += bic(gained, parameters=1, count=10000.0) < 0
    assert taken < 20  # ln(100) is passed by a chi-square of one degree 3 times in 100
    assert by_rows > 120


def test_correlated_noise_counts_by_its_long_run_variance() -> None:
    rng = np.random.default_rng(8)
    share, count = 0.9, 200000
    white = rng.normal(size=count)
    residual = np.zeros(count)
    for k in range(1, count):
        residual[k] = share * residual[k - 1] + white[k]
    block, channel = cells(1000, 200)
    wanted = count * (1 - share) / (1 + share)
    assert independent_rows(residual, block, channel) == pytest.approx(wanted, rel=0.15)
