"""Exact fits take the error of the bank's linearisation away from the sets that lead."""

import numpy as np
import pytest

from loose_env.envs import HiddenMachine, MachineDraw
from loose_env.errors import InvalidSetting, UnknownName
from loose_env.gap import Belief, BeliefSettings, signature_bank
from tests.gap.experiment_design.small_bank import (
    LIBRARY,
    SETTINGS,
    small_bank,
    small_models,
)


def hidden() -> HiddenMachine:
    draw, rng = MachineDraw(least_visible=100.0), np.random.default_rng(4)
    return draw.draw(small_bank(), rng, names=("payload@tool",))


def belief_of(machine: HiddenMachine, **settings: float) -> Belief:
    belief = Belief(small_models(), BeliefSettings(**settings))  # type: ignore[arg-type]
    belief.add(0, machine.run(0, np.random.default_rng(0)))
    return belief


def test_an_exact_fit_explains_what_the_linearisation_leaves() -> None:
    machine = hidden()
    rough, exact = (belief_of(machine, simulations=n).posterior for n in (0, 30))
    (estimate,) = exact.best.effects

    assert exact.best.names == rough.best.names == ("payload@tool",)
    assert exact.best.exact and not rough.best.exact
    assert exact.misfit == 1.0
    (effect,) = machine.effects
    assert estimate.low < effect.value < estimate.high
    assert estimate.high - estimate.low < 0.2 * effect.value


def test_a_wider_prior_of_the_sizes_changes_neither_names_nor_values() -> None:
    machine = hidden()
    narrow, wide = (belief_of(machine, size_sd=sd).posterior.best for sd in (1.3, 3.0))

    assert narrow.names == wide.names
    assert wide.effects[0].value == pytest.approx(narrow.effects[0].value, rel=0.02)


def test_log_evidence_is_that_of_one_effect_alone() -> None:
    belief = belief_of(hidden())

    ahead = belief.log_evidence("payload@tool") - belief.log_evidence("rotor_inertia@joint3")

    assert ahead > 20
    with pytest.raises(UnknownName, match="no candidate 'rust@joint1'"):
        belief.log_evidence("rust@joint1")


def test_candidates_that_no_motion_tells_apart_are_one() -> None:
    settings = type(SETTINGS)(kinds=("rotor_inertia", "link_mass"), points=3, rank=20)

    bank = signature_bank(
        small_bank().arm, LIBRARY[:1], settings, reference=LIBRARY[:1], cache=None
    )

    of_first = {"rotor_inertia@joint1", "link_mass@link1"}  # it turns about the vertical alone
    assert len(of_first & set(bank.names)) == 1
    assert {"rotor_inertia@joint2", "link_mass@link2"} <= set(bank.names)
    assert bank.signatures[0].vectors.shape[1] == bank.nuisances + 3 * len(bank.rays) + sum(
        map(len, bank.shape_columns)
    )


def test_bad_settings_of_the_belief_are_refused() -> None:
    with pytest.raises(InvalidSetting, match="size_sd is above 0"):
        BeliefSettings(size_sd=0.0)
    with pytest.raises(InvalidSetting, match="simulations are 0 or more"):
        BeliefSettings(simulations=-1)
