"""Gap-v0: motions keep to the limits of the arm, and the belief names what is hidden."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import get_args

import mujoco
import numpy as np
import pytest

from loose_env.arms import SERVO_ARM
from loose_env.envs import GapPrices, HiddenMachine, MachineDraw
from loose_env.errors import InvalidData, InvalidSetting
from loose_env.gap import (
    Belief,
    Motion,
    MotionBank,
    ServoArm,
    check_motion,
    motion_bank,
    outlook,
    read_servo_arm,
)
from loose_env.gap.motions import MotionKind, fitting
from tests.gap.cases.small_bank import LIBRARY, small_bank

GOOD = Motion(kind="chirp", joints=(0,), amplitude=0.1, speed=1.0)


@pytest.fixture(scope="module")
def arm() -> ServoArm:
    return read_servo_arm(SERVO_ARM)


@pytest.mark.parametrize("kind", get_args(MotionKind))
def test_a_motion_starts_and_ends_at_rest_at_home_within_amplitude_and_speed(
    kind: MotionKind, arm: ServoArm
) -> None:
    motion = Motion(kind=kind, joints=(0, 2), amplitude=0.2, speed=9.0, seconds=3.0)

    commands = motion.commands(arm.limits)

    off = commands - arm.home
    assert np.all(off[0] == 0) and np.all(off[-1] == 0)
    assert np.all(off[:, 1] == 0)  # a joint that is not excited stays
    assert 0.01 < np.abs(off).max() <= 0.2 + 1e-9
    assert np.abs(np.diff(commands, axis=0)).max() * arm.limits.rate <= arm.max_speed + 1e-9
    assert np.abs(np.diff(off[:70], axis=0)).max() < 1e-9


def test_a_motion_about_another_pose_goes_there_and_back(arm: ServoArm) -> None:
    centre = (0.5, -1.0, 0.8)
    motion = Motion(kind="steps", joints=(1,), amplitude=0.05, speed=1.0, centre=centre)

    commands = motion.commands(arm.limits)

    assert np.allclose(commands[len(commands) // 2], centre, atol=0.11)
    assert np.allclose(commands[[0, -1]], arm.home)


def test_a_motion_that_leaves_a_range_is_refused_and_then_reduced(arm: ServoArm) -> None:
    centre = (0.0, -0.7, 2.2)
    motion = Motion(kind="holds", joints=(2,), amplitude=0.5, speed=1.5, centre=centre)

    with pytest.raises(InvalidSetting, match=r"takes joint3 to .* its range is"):
        motion.commands(arm.limits)
    ((smaller, _),), refused = fitting([motion], partial(check_motion, arm=arm))

    assert smaller.amplitude < motion.amplitude and not refused
    assert not check_motion(smaller, arm)[1]


def test_a_motion_into_the_table_is_refused(arm: ServoArm) -> None:
    low = Motion(kind="holds", joints=(1,), amplitude=0.1, speed=1.0, centre=(0.0, 0.5, 0.4))

    assert "touch" in check_motion(low, arm)[1]
    found, ((_, reason),) = fitting([low], partial(check_motion, arm=arm))
    assert not found and "would touch" in reason


def test_a_weak_drive_gets_a_smaller_motion() -> None:
    spec = mujoco.MjSpec.from_file(str(SERVO_ARM))
    for motor in spec.actuators:
        motor.forcerange = [-45.0, 45.0]
    arm = ServoArm(spec)
    motion = Motion(kind="chirp", joints=(1,), amplitude=0.4, speed=1.8)

    ((slower, planned),), _ = fitting([motion], partial(check_motion, arm=arm))

    assert "reach the range of its force" in check_motion(motion, arm)[1]
    assert slower.speed < motion.speed and np.abs(planned.torque[:, 1]).max() <= 0.8 * 45.0


def believed(machine: HiddenMachine, motions: tuple[int, ...] = (0, 1), seed: int = 0) -> Belief:
    rng = np.random.default_rng(seed)
    belief = Belief(small_bank())
    for motion in motions:
        belief.add(motion, machine.run(motion, rng))
    return belief


def hidden(*names: str, seed: int = 1) -> HiddenMachine:
    draw = MachineDraw(least_visible=40.0)
    return draw.draw(small_bank(), np.random.default_rng(seed), names=names, count=len(names))


def test_the_residual_of_the_nominal_machine_is_white_noise() -> None:
    bank = small_bank()
    healthy = HiddenMachine(bank, (), np.ones(bank.nuisances))
    belief = Belief(bank)

    belief.add(0, healthy.run(0, np.random.default_rng(0)))

    # the evidence believes a tenth more noise than the sensors have
    assert np.mean(belief.sums[0] ** 2) == pytest.approx(1.1**-2, abs=0.16)
    assert belief.rest[0] == pytest.approx(1 / 1.1, abs=0.08)


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
    machine = hidden(*names)

    posterior = believed(machine).posterior

    assert posterior.best.names == names
    assert posterior.best.probability > 0.6
    for estimate, effect in zip(
        posterior.best.effects, sorted(machine.effects, key=lambda e: e.name), strict=True
    ):
        value, low, high = (
            each[effect.main] for each in (estimate.values, estimate.low, estimate.high)
        )
        assert value == pytest.approx(effect.value, rel=0.25)
        assert low < value < high
    assert np.all((posterior.marginal >= 0) & (posterior.marginal <= 1 + 1e-9))


def test_the_posterior_of_healthy_machines_is_calibrated() -> None:
    draw = MachineDraw(probabilities=(1.0, 0.0, 0.0))
    rng = np.random.default_rng(7)

    none = [
        believed(draw.draw(small_bank(), rng), seed=k).posterior.best.names == () for k in range(4)
    ]

    assert sum(none) >= 3


def test_a_residual_that_no_candidate_explains_lowers_the_confidence() -> None:
    machine = hidden("coulomb_friction@joint2")
    readings = machine.run(0, np.random.default_rng(0))
    strange = readings + 3e-3 * np.sin(np.arange(len(readings)) / 9.0)[:, None]
    plain, odd = Belief(small_bank()), Belief(small_bank())
    plain.add(0, readings)
    odd.add(0, strange)

    assert odd.posterior.misfit > plain.posterior.misfit
    assert odd.rest[0] > 2.0 * plain.rest[0]


def test_expected_information_is_of_what_separates_the_open_sets() -> None:
    belief = believed(hidden("coulomb_friction@joint2"), motions=())

    prior = outlook(belief, GapPrices().named).information
    belief = believed(hidden("coulomb_friction@joint2"))

    assert prior[0] > prior[1] > 0  # all joints, not one
    assert outlook(belief, GapPrices().named).information.max() < prior.max()


def test_a_motion_is_worth_what_it_adds_to_the_reward_of_the_verdict() -> None:
    machine = hidden("coulomb_friction@joint2")
    sure, unsure = believed(machine), believed(machine, motions=())
    gains = [outlook(each, GapPrices().named).gain for each in (sure, unsure)]
    assert gains[0].max() < 0.3 < gains[1][0] < 2.0  # right for wrong is worth 2


def test_one_seed_gives_one_machine_and_one_posterior() -> None:
    one, other = (believed(hidden("payload@tool")).posterior for _ in range(2))

    assert one.best == other.best
    assert np.array_equal(one.marginal, other.marginal)


def test_a_stored_bank_is_read_and_a_broken_one_computed_anew(tmp_path: Path) -> None:
    arm = small_bank().arm

    def bank(said: list[str], motions: int = 1) -> MotionBank:
        return motion_bank(
            arm, LIBRARY[:motions], ("payload",), reference=LIBRARY[:1], cache=tmp_path,
            say=said.append,
        )  # fmt: skip

    said: list[str] = []
    first = bank([])
    again = bank(said)
    assert not said  # nothing was computed
    assert np.array_equal(first.evidence[0].rows, again.evidence[0].rows)
    assert [s.name for s in first.shapes] == [s.name for s in again.shapes]
    assert bank(said, motions=2).evidence[1].seconds > 0
    assert len(said) == 1 and "motion 2 of 2" in said[0]  # the motion that is new, alone
    for file in tmp_path.rglob("output.pkl"):
        file.write_bytes(file.read_bytes()[:200])
    found = bank(said)
    assert np.array_equal(found.evidence[0].rows, first.evidence[0].rows) and len(said) == 2


@pytest.mark.parametrize(
    ("made", "error", "words"),
    [
        (lambda arm: replace(GOOD, kind="waltz"), InvalidSetting, "kind must be .*slow_triangle"),
        (lambda arm: replace(GOOD, highest=0.5), InvalidSetting, r"highest must be above 0\.5 Hz"),
        (lambda arm: replace(GOOD, amplitude=0.0), InvalidSetting, "amplitude must be positive"),
        (
            lambda arm: replace(GOOD, joints=(5,)).commands(arm.limits),
            InvalidSetting,
            "drives 3 joints",
        ),
        (lambda arm: MachineDraw(probabilities=(0.5, 0.1, 0.1)), InvalidSetting, "sum to 1"),
        (lambda arm: hidden("rust@joint1"), InvalidSetting, "no candidate 'rust@joint1'; cand"),
    ],
)
def test_what_cannot_be_is_refused(
    made: Callable[[ServoArm], object], error: type[Exception], words: str, arm: ServoArm
) -> None:
    with pytest.raises(error, match=words):
        made(arm)


def test_an_arm_without_servos_is_refused(tmp_path: Path) -> None:
    passive = tmp_path / "passive.xml"
    passive.write_text(
        "<mujoco><worldbody><body><joint name='a'/><geom size='0.1'/></body></worldbody></mujoco>"
    )
    with pytest.raises(InvalidData, match="no position servo"):
        read_servo_arm(passive)
