"""The cases of the gap suite: drawn by number, sized by what can be seen, truth kept apart."""

from __future__ import annotations

import json

import numpy as np
import pytest

pytest.importorskip("numba")
pytest.importorskip("pyarrow")

from loose_env.gap.data.holdout_split import split_runs
from loose_env.recording import read_recording
from scripts.suites.gap.arms import planar3
from scripts.suites.gap.cases import (
    HELD_OUT,
    RUNS,
    VISIBLE,
    Case,
    Visibility,
    draw_case,
    full_list,
    is_written,
    name_of,
    quick_list,
    role_of,
    runs_of,
    tolerance_of,
    truth_of,
    visible_size,
    write_case,
)
from scripts.suites.gap.dynamics import TOLERANCE, Factors
from scripts.suites.gap.effects import CATALOGUE, KINDS, OUTSIDE, Effect
from scripts.suites.gap.grading import Comparison
from scripts.suites.gap.machine import (
    Noise,
    TrueArm,
    add_noise,
    rich_motion,
)

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def arm() -> TrueArm:
    return TrueArm(figures=planar3(), factors=Factors.draw(3, np.random.default_rng(5)))


@pytest.fixture(scope="module")
def noise() -> Noise:
    return Noise.draw(planar3(), np.random.default_rng(6))


@pytest.fixture(scope="module")
def view(arm, noise) -> Visibility:
    motion = rich_motion(np.random.default_rng(7), arm.figures, family="multisine", seconds=2.0)
    return Visibility(arm, motion, noise, "forward")


def test_the_list_holds_every_kind_and_names_say_nothing():
    numbers = full_list()
    names = [name_of(number) for number in numbers]
    assert len(set(names)) == len(numbers)
    assert names != sorted(names)
    assert set(quick_list()) <= set(numbers)
    roles = [role_of(number) for number in numbers]
    assert roles.count("none") >= 100
    assert roles.count("single") % len(CATALOGUE) == 0
    assert roles.count("outside") % len(OUTSIDE) == 0


def test_a_visible_size_scores_three_and_more_is_more(view):
    kind = KINDS["coulomb_friction"]
    place = kind.places(view.arm.figures)[1]
    drawn = kind.draw(np.random.default_rng(0), view.arm.figures, place)
    size = visible_size(view, kind, place, drawn)
    assert size is not None
    assert view.of(kind, place, drawn, size) == pytest.approx(VISIBLE, rel=0.25)
    assert view.of(kind, place, drawn, 3 * size) > 2 * VISIBLE


def test_what_the_tolerance_explains_is_not_seen_and_a_little_more_is(view):
    """A heavier rotor is a figure of the model as far as the tolerance reaches from there."""
    kind = KINDS["rotor_inertia"]
    for joint, place in enumerate(kind.places(view.arm.figures)):
        armature = view.arm.figures.links[joint].armature
        room = 1 + TOLERANCE - view.arm.factors.armature[joint]
        assert view.of(kind, place, {}, 0.95 * room * armature) < 0.2
        size = visible_size(view, kind, place, {})
        assert size is None or size > room * armature


def test_a_case_is_drawn_by_its_number_alone():
    one, again, other = draw_case(3), draw_case(3), draw_case(4)
    assert truth_of(one) == truth_of(again)
    assert truth_of(one)["factors"] != truth_of(other)["factors"]
    first, second = runs_of(one)[0], runs_of(again)[0]
    for sensor in first.sensors:
        np.testing.assert_array_equal(first.sensors[sensor], second.sensors[sensor])


@pytest.fixture(scope="module")
def friction_case(arm, noise) -> Case:
    kind = KINDS["coulomb_friction"]
    place = kind.places(arm.figures)[0]
    drawn = kind.draw(np.random.default_rng(0), arm.figures, place)
    effect = Effect(
        kind=kind.name, place=place, parameters=kind.size(2.0, drawn, arm.figures, place)
    )
    rng = np.random.default_rng(9)
    runs = tuple(
        rich_motion(rng, arm.figures, family=family, seconds=1.5)
        for family in ("multisine", "steps")
    )
    return Case(
        number=1001,
        form="forward",
        arm=TrueArm(figures=arm.figures, factors=arm.factors, effects=(effect,)),
        motions=runs,
        noise=noise,
        sizes=({"size": 2.0, "visible": 1.0, "ratio": 2.0},),
    )


def test_a_recording_reads_and_tells_nothing(tmp_path, friction_case):
    recordings, truth = tmp_path / "recordings", tmp_path / "truth"
    folder = write_case(friction_case, recordings=recordings, truth=truth)
    recording = read_recording(folder)
    run = recording.runs[0]
    assert run.comparison == "forward"
    assert run.sensors["tool_acc"].shape == (1500, 3)
    assert set(run.controls) == {"motor1", "motor2", "motor3"}
    said = "".join(path.read_text() for path in folder.glob("*.[jx]*"))
    assert not any(word in said for word in ("coulomb", "friction", "planar", "gap", "single"))
    sealed = json.loads((truth / f"{friction_case.name}.json").read_text())
    assert sealed["effects"][0]["kind"] == "coulomb_friction"
    assert is_written(1001, friction_case.name, recordings=recordings, truth=truth)


def test_truth_inside_the_recordings_is_refused(tmp_path, friction_case):
    with pytest.raises(ValueError, match="keep it apart"):
        write_case(friction_case, recordings=tmp_path, truth=tmp_path / "truth")


def test_readings_have_the_noise_and_the_steps_they_are_said_to_have(arm, noise):
    motion = rich_motion(np.random.default_rng(1), arm.figures, family="steps", seconds=2.0)
    clean = arm.run(motion)
    noisy = add_noise(clean, noise, np.random.default_rng(2))
    steps = noisy.position / noise.step
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    error = (noisy.normalised(noise) - clean.normalised(noise)).std(axis=0)
    np.testing.assert_allclose(error, 1.0, atol=0.1)


def test_an_outside_effect_is_seen_beyond_what_the_catalogue_explains(view):
    kind = KINDS["drive_hysteresis"]
    place = kind.places(view.arm.figures)[1]
    drawn = {"stroke": 0.3}
    beyond = view.of(kind, place, drawn, 2.0)
    effect = Effect(kind=kind.name, place=place, parameters={"torque": 2.0, **drawn})
    assert VISIBLE < beyond < view.score(view.excess(view.difference((effect,))))


@pytest.mark.parametrize("number", [1011, 3004])
def test_a_drawn_effect_is_seen(number):
    case = draw_case(number)
    (effect,), (size,) = case.arm.effects, case.sizes
    assert effect.kind == (CATALOGUE[11] if number == 1011 else OUTSIDE[4])
    assert 1.0 <= size["ratio"] <= 30.0
    seen = Visibility(case.arm, case.motions[HELD_OUT], case.noise, case.form)
    assert seen.score(seen.excess(seen.difference(case.arm.effects))) > VISIBLE


def test_tilt_and_first_encoder_of_a_planar_arm_are_one_and_friction_is_neither(
    arm, noise, friction_case
):
    kind = KINDS["base_tilt"]
    place = kind.places(arm.figures)[0]
    effect = Effect(kind="base_tilt", place=place, parameters={"angle": 0.02, "x": 0.0, "y": 0.02})
    tilted = Case(
        number=1020,
        form="forward",
        arm=TrueArm(figures=arm.figures, factors=arm.factors, effects=(effect,)),
        motions=friction_case.motions,
        noise=noise,
        sizes=({"size": 0.02, "visible": 0.01, "ratio": 2.0},),
    )
    comparison = Comparison(tilted)
    assert not comparison.separable(0, ("encoder_offset", "joint1"))
    assert comparison.separable(0, ("coulomb_friction", "joint1"))
    assert comparison.separable(0, ("encoder_offset", "nowhere"))


def test_the_run_that_decides_what_is_visible_is_one_that_the_tool_holds_out():
    _, held = split_runs([f"run-{k + 1:02d}" for k in range(RUNS)])
    assert held == [RUNS + HELD_OUT]


@pytest.mark.parametrize("number", [4001, 4002])
def test_a_triple_has_three_effects_at_places_of_their_own(number: int) -> None:
    case = draw_case(number)
    assert case.role == role_of(number) == "triple"
    assert len({effect.kind for effect in case.arm.effects}) == 3
    assert len({effect.place.index for effect in case.arm.effects}) == 3
    assert all(size["ratio"] >= 1.0 for size in case.sizes)


def test_a_whole_machine_has_many_clearly_visible_effects() -> None:
    case = draw_case(5001)
    assert case.role == "machine"
    assert 5 <= len(case.arm.effects) <= 15
    assert all(size["ratio"] >= 3.0 for size in case.sizes)
    off = np.abs(case.arm.factors.flat() - 1.0)
    assert off.min() >= 0.03 and off.max() <= tolerance_of(5001) == 0.10
    assert tolerance_of(1001) == TOLERANCE
    assert np.array_equal(draw_case(5001).arm.factors.flat(), case.arm.factors.flat())
