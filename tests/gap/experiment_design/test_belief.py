"""The belief names what is hidden, is not overconfident, and prefers motions that tell apart."""

from pathlib import Path

import numpy as np
import pytest

from loose_env.envs import GapPrices, HiddenMachine, MachineDraw
from loose_env.errors import InvalidSetting
from loose_env.gap import (
    Belief,
    BeliefSettings,
    SignatureBank,
    outlook,
    pair_gains,
    rays_of,
    signature_bank,
)
from loose_env.gap.experiment_design.inference.information import value_of_information
from loose_env.gap.simulation.torque_terms import has_terms
from tests.gap.experiment_design.small_bank import (
    LIBRARY,
    SETTINGS,
    small_bank,
    small_models,
)


def believed(machine: HiddenMachine, motions: tuple[int, ...] = (0, 1), seed: int = 0) -> Belief:
    rng = np.random.default_rng(seed)
    belief = Belief(small_models())
    for motion in motions:
        belief.add(motion, machine.run(motion, rng))
    return belief


def machine(*names: str, seed: int = 1) -> HiddenMachine:
    draw = MachineDraw(least_visible=40.0)
    return draw.draw(small_bank(), np.random.default_rng(seed), names=names, count=len(names))


@pytest.mark.parametrize(
    "names",
    [
        (),
        ("coulomb_friction@joint2",),
        ("payload@tool",),
        ("coulomb_friction@joint1", "rotor_inertia@joint3"),
    ],
)
def test_the_most_probable_set_is_what_is_hidden(names: tuple[str, ...]) -> None:
    hidden = machine(*names)

    posterior = believed(hidden).posterior

    assert posterior.best.names == names
    assert posterior.best.probability > 0.6
    for estimate, effect in zip(
        posterior.best.effects, sorted(hidden.effects, key=lambda e: e.name), strict=True
    ):
        assert estimate.value == pytest.approx(effect.value, rel=0.25)
        assert estimate.low < estimate.value < estimate.high
    assert np.all((posterior.marginal >= 0) & (posterior.marginal <= 1 + 1e-9))


def test_the_posterior_of_healthy_machines_is_calibrated() -> None:
    draw = MachineDraw(probabilities=(1.0, 0.0, 0.0))
    rng = np.random.default_rng(7)

    none = [
        believed(draw.draw(small_bank(), rng), seed=k).posterior.best.names == () for k in range(4)
    ]

    assert sum(none) >= 3


def test_a_residual_that_no_candidate_explains_lowers_the_confidence() -> None:
    hidden = machine("coulomb_friction@joint2")
    readings = hidden.run(0, np.random.default_rng(0))
    strange = readings + 3e-3 * np.sin(np.arange(len(readings)) / 9.0)[:, None]
    plain, odd = Belief(small_models()), Belief(small_models())
    plain.add(0, readings)
    odd.add(0, strange)

    assert odd.posterior.misfit > plain.posterior.misfit
    assert odd.rest[0] > 2.0 * plain.rest[0]


def test_expected_information_is_of_what_separates_the_open_sets() -> None:
    belief = believed(machine("coulomb_friction@joint2"), motions=())

    prior = outlook(belief, GapPrices().named).information
    belief = believed(machine("coulomb_friction@joint2"))
    gains = pair_gains(belief, 0)

    assert prior[0] > prior[1] > 0  # all joints, not one
    assert outlook(belief, GapPrices().named).information.max() < prior.max()
    assert gains.shape[0] == gains.shape[1] and np.allclose(gains, gains.T)
    assert np.allclose(np.diag(gains), 0.0)


def test_a_motion_is_worth_what_it_adds_to_the_reward_of_the_verdict() -> None:
    rewards, equal = 2 * np.eye(2) - 1, np.full(2, 0.5)
    apart = [
        value_of_information(equal, np.diag([d**2, 0.0]), rewards) for d in (0.0, 1.0, 2.0, 9.0)
    ]
    # of two equal sets d standard deviations apart, the right one is named with Φ(d / 2)
    assert apart == pytest.approx([0.0, 0.383, 0.683, 1.0], abs=0.1)
    likely = np.array([0.999, 0.001])
    assert value_of_information(likely, np.diag([1.0, 0.0]), rewards) < 0.01
    hidden = machine("coulomb_friction@joint2")
    sure, unsure = believed(hidden), believed(hidden, motions=())
    gains = [outlook(each, GapPrices().named).gain for each in (sure, unsure)]
    assert gains[0].max() < 0.3 < gains[1][0] < 2.0  # right for wrong is worth 2


def test_simulations_made_together_are_those_made_alone() -> None:
    arm = small_bank().arm
    rays = rays_of(arm, ["load_friction", "dead_zone", "payload"])
    hypotheses = [ray.hypothesis(ray.values(1.0)) for ray in rays[::3]]
    commands = [motion.commands(arm)[:200] for motion in LIBRARY]

    together = arm.simulate_motions(hypotheses, commands)

    assert any(map(has_terms, hypotheses)) and not all(map(has_terms, hypotheses))
    for each, found in zip(commands, together, strict=True):
        for k, hypothesis in enumerate(hypotheses):
            assert np.array_equal(arm.simulate([hypothesis], each)[0], found[k])


def test_one_seed_gives_one_machine_and_one_posterior() -> None:
    one, other = (believed(machine("payload@tool")).posterior for _ in range(2))

    assert one.best == other.best
    assert np.array_equal(one.marginal, other.marginal)


def test_a_stored_bank_is_read_and_a_broken_one_computed_anew(tmp_path: Path) -> None:
    arm = small_bank().arm
    settings = type(SETTINGS)(kinds=("payload",), points=2, rank=12)

    def bank(said: list[str], motions: int = 1) -> SignatureBank:
        return signature_bank(
            arm, LIBRARY[:motions], settings, reference=LIBRARY[:1], cache=tmp_path,
            say=said.append,
        )  # fmt: skip

    said: list[str] = []
    first = bank([])
    again = bank(said)
    assert not said  # nothing was computed
    assert np.array_equal(first.signatures[0].vectors, again.signatures[0].vectors)
    assert [r.name for r in first.rays] == [r.name for r in again.rays]
    assert bank(said, motions=2).signatures[1].seconds > 0
    assert len(said) == 1 and "motion 2 of 2" in said[0]  # the motion that is new, alone
    for file in tmp_path.glob("*/*.npz"):
        file.write_bytes(file.read_bytes()[:200])
    found = bank(said)
    assert all(map(np.array_equal, found.sizes, first.sizes)) and len(said) > 2
    assert '"kinds"' in next(tmp_path.glob("*/bank.json")).read_text()


def test_bad_settings_and_names_are_refused() -> None:
    with pytest.raises(InvalidSetting, match="probabilities of at most 1 in all"):
        BeliefSettings(none=0.8, single=0.4)
    with pytest.raises(InvalidSetting, match="sum to 1"):
        MachineDraw(probabilities=(0.5, 0.1, 0.1))
    with pytest.raises(InvalidSetting, match="no candidate 'rust@joint1'; candidates are"):
        machine("rust@joint1")
