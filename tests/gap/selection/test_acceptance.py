"""What a hypothesis has to explain before it is believed."""

from __future__ import annotations

from dataclasses import replace
from math import inf

import numpy as np
import pytest

from loose_env.gap.fitting.gauss_newton import Fit
from loose_env.gap.fitting.holdout_score import (
    ScoredFit,
    Scorer,
    explained_share,
    improvement_of,
    z_score,
)
from loose_env.gap.model.effects.catalogue import CATALOGUE
from loose_env.gap.selection.acceptance import Acceptance
from loose_env.gap.settings import ACCEPTED_Z, CONFIRMED_Z, SearchSettings
from tests.gap.selection.test_ranking import COMPARED, LATE, MACHINE, NOMINAL

LEVELS = 2.5, 1.2
"""Of what the nominal model leaves, and of what is left with what was found before."""


def left(level: float, *, named: bool = False, quieter: float = 1.0) -> ScoredFit:
    """A hypothesis that leaves the same noise as another, in one block of two by a factor less."""
    rng = np.random.default_rng(1)
    structure = NOMINAL.with_effects(LATE if named else ())
    free = np.zeros(len(structure.parameters))
    own = np.where(COMPARED.rows.block % 2 == 0, quieter, 1.0)
    residual, held = level * own * rng.normal(size=(2, len(COMPARED)))
    blocks = [COMPARED.by_block(r**2) for r in (held, residual)]
    noise = COMPARED.by_block(np.ones(len(COMPARED)))
    return ScoredFit(
        fitted=Fit(
            structure=structure, free=free, residual=residual,
            jacobian=np.zeros((0, len(free))), cost=float(residual @ residual),
        ),
        held_out_residual=held, held_out_blocks=blocks[0], training_blocks=blocks[1],
        held_out_noise=noise, training_noise=noise,
        held_out_products=np.tile(blocks[0], (3, 1)), training_products=np.tile(blocks[1], (3, 1)),
        channel_products=np.zeros((2, 1)),
    )  # fmt: skip


def test_what_is_slight_and_everywhere_is_believed_only_where_that_is_asked_for() -> None:
    base, before = (left(level) for level in LEVELS)
    negligible = left(0.96 * LEVELS[1], named=True)
    improvement = improvement_of(negligible, before)
    assert min(improvement.held_out, improvement.training) > 8 and improvement.share < 0.1
    scorer, settings = Scorer(COMPARED, COMPARED), SearchSettings()
    assert settings.sufficient_z == inf
    for least, believed in ((inf, False), (8.0, True), (20.0, False)):
        asked = replace(settings, sufficient_z=least)
        acceptance = Acceptance(COMPARED, scorer, base, before, asked)
        assert acceptance.accepts(negligible) is believed


def test_fewer_parameters_do_not_outweigh_what_is_slight_and_everywhere() -> None:
    base, before = (left(level) for level in LEVELS)
    negligible, simpler = left(0.993 * LEVELS[1], named=True), left(LEVELS[1])
    improvement = improvement_of(negligible, simpler)
    assert min(improvement.held_out, improvement.training) > 8 and improvement.share < 0.02
    for least, first in ((inf, simpler), (8.0, negligible)):
        asked = SearchSettings(sufficient_z=least)
        acceptance = Acceptance(COMPARED, Scorer(COMPARED, COMPARED), base, before, asked)
        assert acceptance.ranked([simpler, negligible])[0] is first


def test_of_those_that_leave_the_same_the_one_that_changes_least_comes_first() -> None:
    base, before = (left(level) for level in LEVELS)
    acceptance = Acceptance(COMPARED, Scorer(COMPARED, COMPARED), base, before, SearchSettings())

    def with_effect(kind: str, where: str, times: float, level: float) -> ScoredFit:
        """With a mass or a rotor, so many times its scale."""
        effect, found = CATALOGUE[kind](MACHINE, where), left(level)
        free = np.append(found.fitted.free, times)
        fitted = replace(found.fitted, structure=found.fitted.structure.plus(effect), free=free)
        return replace(found, fitted=fitted)

    rotor = with_effect("rotor_inertia", "joint1", 1.5, 1.0)
    heavy = with_effect("link_mass", "link1", -9.0, 1.0)
    light = with_effect("link_mass", "link1", 0.5, 1.0)
    better = with_effect("link_mass", "link1", -9.0, 0.99)
    assert acceptance.ranked([heavy, rotor])[0] is rotor
    assert acceptance.ranked([rotor, light])[0] is light
    assert acceptance.ranked([rotor, better])[0] is better


def test_what_is_loud_counts_though_it_does_not_hang_together() -> None:
    still = np.zeros((3, 2))

    def impact_power(level: float) -> ScoredFit:
        return replace(left(level), held_out_products=still, training_products=still)

    noise, loud, less = impact_power(1.0), impact_power(3.0), impact_power(1.8)
    assert not noise.above_noise and loud.above_noise and less.above_noise
    assert loud.impact_dominated and not noise.impact_dominated and not left(3.0).impact_dominated
    assert loud.autocorrelation_z == 0.0
    assert explained_share(less, loud) == pytest.approx(1 - (1.8**2 - 1) / (3.0**2 - 1), rel=0.02)
    assert improvement_of(noise, loud).share > 0.98
    assert explained_share(loud, noise) == 0.0  # of nothing


def test_what_shows_in_half_of_the_blocks_leads_less_than_what_shows_in_all() -> None:
    before = left(LEVELS[1])
    whole = improvement_of(left(0.96 * LEVELS[1], named=True), before)
    half = improvement_of(left(LEVELS[1], named=True, quieter=0.92), before)
    assert half.share > 0.9 * whole.share
    assert half.held_out < 0.8 * whole.held_out and half.training < 0.8 * whole.training


def test_a_blow_that_is_missed_does_not_outweigh_what_a_part_with_stops_explains() -> None:
    before, after = left(LEVELS[0]), left(0.6 * LEVELS[0], named=True)
    for blocks in (after.held_out_blocks, after.training_blocks):
        blocks[0] = 1e4 * blocks[0]
    asked = improvement_of(after, before)
    assert max(asked.held_out, asked.training) < CONFIRMED_Z
    ranked = improvement_of(after, before, by_rank=True)
    assert min(ranked.held_out, ranked.training) > ACCEPTED_Z
    # of what explains nothing ranks say nothing, however many blows it misses
    rng = np.random.default_rng(2)
    chance = rng.normal(size=40) ** 2
    assert abs(z_score(chance, rng.permutation(chance), np.ones(40), by_rank=True)) < ACCEPTED_Z


def test_an_effect_in_few_blocks_is_as_sure_as_it_is_large_where_noise_is_left() -> None:
    rng = np.random.default_rng(3)
    noise = np.full(40, 100.0)
    without = rng.chisquare(100, size=40)
    with_it = without.copy()
    without[:3] += 300.0
    assert z_score(without, with_it, noise) > 10 > -10 > z_score(with_it, without, noise)
    # where as much is left above the noise, three blocks are three that agree
    assert z_score(without + 900.0, with_it + 900.0, noise) < CONFIRMED_Z
    # what chance alone explains is no surer than before
    redrawn = np.array([z_score(*rng.chisquare(100, size=(2, 40)), noise) for _ in range(400)])
    assert abs(redrawn.mean()) < 0.2 and redrawn.std() < 1.4
