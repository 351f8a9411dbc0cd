"""What a hypothesis has to explain before it is believed."""

from __future__ import annotations

from dataclasses import replace
from math import inf

import numpy as np
import pytest

from loose_env.gap.fitting.gauss_newton import Fit
from loose_env.gap.fitting.holdout_score import Judge, Judged, lead_of, share_of, sureness_of
from loose_env.gap.model.effects.catalogue import CATALOGUE
from loose_env.gap.selection.acceptance import Acceptance
from loose_env.gap.settings import SearchSettings
from tests.gap.selection.test_ranking import COMPARED, LATE, MACHINE, NOMINAL

LEVELS = 2.5, 1.2
"""Of what the nominal model leaves, and of what is left with what was found before."""


def left(level: float, *, named: bool = False, quieter: float = 1.0) -> Judged:
    """A hypothesis that leaves the same noise as another, in one block of two by a factor less."""
    rng = np.random.default_rng(1)
    structure = NOMINAL.with_effects(LATE if named else ())
    free = np.zeros(len(structure.parameters))
    own = np.where(COMPARED.rows.block % 2 == 0, quieter, 1.0)
    residual, held = level * own * rng.normal(size=(2, len(COMPARED)))
    blocks = [COMPARED.by_block(r**2) for r in (held, residual)]
    return Judged(
        fitted=Fit(
            structure=structure, free=free, residual=residual,
            jacobian=np.zeros((0, len(free))), cost=float(residual @ residual),
        ),
        held_residual=held, held_blocks=blocks[0], fitted_blocks=blocks[1],
        held_structure=np.tile(blocks[0], (3, 1)), fitted_structure=np.tile(blocks[1], (3, 1)),
        channel_structure=np.zeros((2, 1)),
    )  # fmt: skip


def test_what_is_slight_and_everywhere_is_believed_only_where_that_is_asked_for() -> None:
    base, before = (left(level) for level in LEVELS)
    slight = left(0.96 * LEVELS[1], named=True)
    lead = lead_of(slight, before)
    assert min(lead.held, lead.fitted) > 8 and lead.share < 0.1
    judge, settings = Judge(COMPARED, COMPARED), SearchSettings()
    assert settings.sufficient_z == inf
    for least, believed in ((inf, False), (8.0, True), (20.0, False)):
        asked = replace(settings, everywhere=least)
        acceptance = Acceptance(COMPARED, judge, base, before, asked)
        assert acceptance.worth_naming(slight) is believed


def test_fewer_parameters_do_not_outweigh_what_is_slight_and_everywhere() -> None:
    base, before = (left(level) for level in LEVELS)
    slight, simpler = left(0.993 * LEVELS[1], named=True), left(LEVELS[1])
    lead = lead_of(slight, simpler)
    assert min(lead.held, lead.fitted) > 8 and lead.share < 0.02
    for least, first in ((inf, simpler), (8.0, slight)):
        asked = SearchSettings(sufficient_z=least)
        acceptance = Acceptance(COMPARED, Judge(COMPARED, COMPARED), base, before, asked)
        assert acceptance.ranked([simpler, slight])[0] is first


def test_of_those_that_leave_the_same_the_one_that_changes_least_comes_first() -> None:
    base, before = (left(level) for level in LEVELS)
    acceptance = Acceptance(COMPARED, Judge(COMPARED, COMPARED), base, before, SearchSettings())

    def with_effect(kind: str, where: str, times: float, level: float) -> Judged:
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

    def blows(level: float) -> Judged:
        return replace(left(level), held_structure=still, fitted_structure=still)

    noise, loud, less = blows(1.0), blows(3.0), blows(1.8)
    assert not noise.loud and loud.loud and less.loud
    assert loud.blows and not noise.blows and not left(3.0).blows
    assert loud.structure_sureness == 0.0
    assert share_of(less, loud) == pytest.approx(1 - (1.8**2 - 1) / (3.0**2 - 1), rel=0.02)
    assert lead_of(noise, loud).share > 0.98
    assert share_of(loud, noise) == 0.0  # of nothing


def test_what_shows_in_half_of_the_blocks_leads_less_than_what_shows_in_all() -> None:
    before = left(LEVELS[1])
    whole = lead_of(left(0.96 * LEVELS[1], named=True), before)
    half = lead_of(left(LEVELS[1], named=True, quieter=0.92), before)
    assert half.share > 0.9 * whole.share
    assert half.held < 0.8 * whole.held and half.fitted < 0.8 * whole.fitted


def test_a_blow_that_is_missed_does_not_outweigh_what_a_part_with_stops_explains() -> None:
    before, after = left(LEVELS[0]), left(0.6 * LEVELS[0], named=True)
    for blocks in (after.held_blocks, after.fitted_blocks):
        blocks[0] = 1e4 * blocks[0]
    asked, settings = lead_of(after, before), SearchSettings()
    assert max(asked.held, asked.fitted) < settings.held
    ranked = lead_of(after, before, strikes=True)
    assert min(ranked.held, ranked.fitted) > settings.sureness
    # of what explains nothing ranks say nothing, however many blows it misses
    rng = np.random.default_rng(2)
    chance = rng.normal(size=40) ** 2
    assert abs(sureness_of(chance, rng.permutation(chance), strikes=True)) < settings.sureness
