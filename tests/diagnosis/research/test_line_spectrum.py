"""The dynamic model finds the open seat and its direction where the holding gives way."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from loose_env.arms import Arm, LinearArm, Mismatch, planar, servoed, six_axis, with_compliance
from loose_env.diagnosis.link_finding.direction_images import ToolFrames
from loose_env.diagnosis.research.line_spectrum.direction import (
    DynamicDirection,
    direction_by_dynamics,
)
from loose_env.diagnosis.research.line_spectrum.uncertain_arm import UncertainArm
from loose_env.errors import InvalidData, InvalidSetting, UnknownName
from loose_env.excitation import Excitation, at_levels
from loose_env.faults import Healthy, StructuralLooseness
from loose_env.rig import Measurement, SimulatedRig
from loose_env.typing import Array

NONE = Mismatch().scaled(0.0)
RATE, DURATION = 1000.0, 0.6


def geared(arm: Arm) -> Arm:
    """Gears whose modes lie in the middle of the band."""
    return with_compliance(arm, mode_hz=70.0)


def degrees_between(u: Array, v: Array) -> float:
    return float(np.degrees(np.arccos(np.clip(abs(u @ v), 0.0, 1.0))))


def linear_record(
    arm: UncertainArm,
    pose: Array,
    joints: Sequence[int],
    *,
    errors: Array | None = None,
    seat: Array | None = None,
    seed: int = 0,
) -> Measurement:
    """What a linear arm without noise shows, its seat moving in any way, not as the drive asks."""
    nominal = arm.linear.arm
    rng = np.random.default_rng(seed)
    count = round(RATE * DURATION)
    frequency = np.fft.rfftfreq(count, 1 / RATE)
    kept = (frequency >= nominal.band[0] - 1e-9) & (frequency <= nominal.band[1] + 1e-9)
    on = np.isin(np.arange(nominal.n), joints)
    found = np.zeros(len(arm.names)) if errors is None else errors
    answer = arm.at(pose).answer(frequency[kept], on, found)

    def lines(columns: int) -> NDArray[np.complex128]:
        return rng.standard_normal((kept.sum(), columns, 2)) @ np.array([1.0, 1j]) * count / 20

    torque = lines(len(joints))
    readings = np.einsum("kcm,km->kc", answer.transfer, torque)
    if seat is not None:
        moved = 3.0 * np.abs(readings[:, :2]).mean() / count * 20 * 0.1 * lines(1)
        readings = readings + (answer.columns @ seat) * moved
    d = len(nominal.axes)

    def in_time(spectrum: NDArray[np.complex128]) -> Array:
        full = np.zeros((len(frequency), spectrum.shape[1]), dtype=complex)
        full[kept] = spectrum
        return np.asarray(np.fft.irfft(full, count, axis=0).T)

    command, encoder = np.zeros((nominal.n, count)), np.zeros((nominal.n, count + 2))
    command[on] = in_time(torque)
    angle = in_time(readings[:, d:] / -((2 * np.pi * frequency[kept, None]) ** 2))
    encoder[on] = np.hstack([angle[:, -1:], angle, angle[:, :1]])
    shake = Excitation(torque_rms=tuple(float(e) for e in on), duration=DURATION, band=nominal.band)
    return Measurement(
        pose=pose,
        excitation=shake,
        rate=RATE,
        command=command,
        encoder=encoder,
        tool=in_time(readings[:, :d]),
    )


def seat_of(arm: UncertainArm, place: str, direction: Array) -> Array:
    """Motion of all seats when one moves."""
    n, s = arm.linear.slide_dofs.shape
    seat = np.zeros(n * s + n)
    number = int(place[-1]) - 1
    if place.startswith("structural"):
        seat[number * s : (number + 1) * s] = direction
    else:
        seat[n * s + number] = 1.0
    return seat


def one_by_one(
    arm: UncertainArm, poses: Sequence[Array], seed: int = 0, **options: Array | None
) -> list[Measurement]:
    n = arm.linear.arm.n
    return [
        linear_record(arm, pose, [j], seed=seed + 100 * p + j, **options)
        for p, pose in enumerate(poses)
        for j in range(n)
    ]


@pytest.mark.parametrize("make", [planar, lambda _: six_axis()])
@pytest.mark.parametrize("hold", ["gears", "servo"])
def test_the_uncertain_arm_answers_as_the_linear_one(make: Callable[..., Arm], hold: str) -> None:
    arm = geared(make(3)) if hold == "gears" else servoed(make(3), mode_hz=45.0)
    linear = LinearArm(arm, points=20)
    pose, excited = arm.random_pose(np.random.default_rng(2)), np.arange(arm.n) == 1
    known = UncertainArm(linear, NONE)
    assert not known.names
    answer = known.at(pose).answer(linear.frequency, excited, np.zeros(0))
    sound, opened = linear.at(pose).response(excited), linear.at(pose).open_response(excited)
    d, n = len(arm.axes), arm.n
    np.testing.assert_allclose(answer.transfer[:, :d], sound.tool, atol=1e-12)
    np.testing.assert_allclose(answer.transfer[:, d:], sound.joint[:, 1:2], atol=1e-12)
    slides = opened.tool_open_slide.reshape(20, d, -1)
    np.testing.assert_allclose(answer.columns[:, :d, :-n], slides, atol=1e-10)
    np.testing.assert_allclose(answer.columns[:, :d, -n:], opened.tool_open_hinge, atol=1e-10)
    np.testing.assert_allclose(answer.columns[:, d:, -n:], opened.joint_open_hinge, atol=1e-10)


@pytest.mark.parametrize("arm", [geared(planar(3)), servoed(six_axis(), mode_hz=45.0)])
def test_slopes_are_the_changes_that_errors_make(arm: Arm) -> None:
    linear = LinearArm(arm, points=20)
    uncertain = UncertainArm(linear, Mismatch())
    rng = np.random.default_rng(1)
    at, excited = uncertain.at(arm.random_pose(rng)), np.arange(arm.n) == 1
    errors = 0.3 * rng.standard_normal(len(uncertain.names))
    torque = rng.standard_normal((20, 1)) + 0j
    seat = rng.standard_normal((20, len(uncertain.seats)))

    def readings(errors: Array) -> NDArray[np.complex128]:
        answer = at.answer(linear.frequency, excited, errors)
        return np.asarray(
            np.einsum("kcm,km->kc", answer.transfer, torque)
            + np.einsum("kcs,ks->kc", answer.columns, seat)
        )

    answer = at.answer(linear.frequency, excited, errors)
    motion = np.einsum("kvm,km->kv", answer.by_torque, torque)
    motion = motion + np.einsum("kvs,ks->kv", answer.by_seat, seat)
    slopes = at.slopes(linear.frequency, excited, errors, answer, motion, torque)
    for p in range(len(errors)):
        step = np.zeros(len(errors))
        step[p] = 1e-4
        expected = (readings(errors + step) - readings(errors - step)) / 2e-4
        size = np.abs(expected).max()
        np.testing.assert_allclose(slopes[p], expected, atol=1e-3 * size + 1e-7)


@pytest.mark.parametrize("arm", [geared(planar(3)), geared(six_axis()), planar(3)])
def test_a_linear_arm_without_noise_gives_the_direction_exactly(arm: Arm) -> None:
    uncertain = UncertainArm(LinearArm(arm, points=2), NONE)
    rng = np.random.default_rng(5)
    poses = [arm.random_pose(rng) for _ in range(2)]
    direction = rng.standard_normal(len(arm.axes))
    direction /= np.linalg.norm(direction)
    seat = seat_of(uncertain, "structural_looseness@link2", direction)
    records = one_by_one(uncertain, poses, seat=seat)
    for healthy in (None, one_by_one(uncertain, poses, seed=7)):
        found = direction_by_dynamics(uncertain.linear, records, healthy=healthy, mismatch=NONE)
        assert found.location == "structural_looseness@link2"
        assert found.direction_in_link is not None
        assert degrees_between(found.direction_in_link, direction) < 0.05
        seen = ToolFrames(arm).images(poses[0])[0, 1] @ direction
        assert degrees_between(found.direction_in_tool, seen) < 0.05
        assert found.evidence > 100
        assert np.sort(found.misfits)[1] > found.misfits.min() + 20


def test_gears_in_the_band_tell_the_link_in_one_pose() -> None:
    arm = geared(planar(3))
    uncertain = UncertainArm(LinearArm(arm, points=2), NONE)
    pose = np.array([0.2, 0.9, -0.7])
    for number in (1, 2, 3):
        place = f"structural_looseness@link{number}"
        seat = seat_of(uncertain, place, np.array([0.6, 0.8]))
        found = direction_by_dynamics(
            uncertain.linear, one_by_one(uncertain, [pose], seat=seat), mismatch=NONE
        )
        assert found.location == place


def test_play_in_a_joint_is_told_from_a_slide() -> None:
    arm = geared(planar(3))
    uncertain = UncertainArm(LinearArm(arm, points=2), NONE)
    pose = np.array([0.2, 0.9, -0.7])
    seat = seat_of(uncertain, "backlash@joint2", np.zeros(0))
    found = direction_by_dynamics(
        uncertain.linear, one_by_one(uncertain, [pose], seat=seat), mismatch=NONE
    )
    assert found.location == "backlash@joint2"
    assert found.direction_in_link is None
    line = ToolFrames(arm).unit_lines(pose)[0, 1]
    assert degrees_between(found.direction_in_tool, line) < 1e-3


@pytest.mark.parametrize("with_healthy", [True, False])
def test_errors_of_the_model_are_learnt(with_healthy: bool) -> None:
    arm = geared(planar(3))
    uncertain = UncertainArm(LinearArm(arm, points=2), Mismatch())
    pose, direction = np.array([0.2, 0.9, -0.7]), np.array([0.6, 0.8])
    gears = [uncertain.names.index(f"stiffness{k}") for k in (4, 5, 6)]
    errors = np.zeros(len(uncertain.names))
    errors[gears] = 1.5, -1.2, 1.0
    seat = seat_of(uncertain, "structural_looseness@link1", direction)
    loose = one_by_one(uncertain, [pose], seat=seat, errors=errors)
    healthy = one_by_one(uncertain, [pose], seed=7, errors=errors) if with_healthy else None
    found = direction_by_dynamics(uncertain.linear, loose, healthy=healthy)
    assert found.location == "structural_looseness@link1"
    assert found.direction_in_link is not None
    assert degrees_between(found.direction_in_link, direction) < 0.5
    assert found.error_names == uncertain.names
    np.testing.assert_allclose(found.errors[gears], errors[gears], atol=0.4)
    blind = direction_by_dynamics(uncertain.linear, loose, mismatch=NONE)
    assert degrees_between(np.asarray(blind.directions[0]), direction) > degrees_between(
        found.direction_in_link, direction
    )


def test_joints_that_are_excited_together_need_as_many_healthy_records() -> None:
    arm = geared(planar(3))
    uncertain = UncertainArm(LinearArm(arm, points=2), NONE)
    pose, direction = np.array([0.2, 0.9, -0.7]), np.array([0.6, 0.8])
    seat = seat_of(uncertain, "structural_looseness@link2", direction)
    loose = [linear_record(uncertain, pose, [0, 2], seat=seat)]
    healthy = [linear_record(uncertain, pose, [0, 2], seed=s) for s in (1, 2)]
    found = direction_by_dynamics(uncertain.linear, loose, healthy=healthy, link=2, mismatch=NONE)
    assert found.locations == ("structural_looseness@link2",)
    assert degrees_between(found.direction_in_tool, _seen(arm, pose, 2, direction)) < 0.05
    with pytest.raises(InvalidData, match="2 or more healthy records like it are needed, 1 given"):
        direction_by_dynamics(uncertain.linear, loose, healthy=healthy[:1])
    with pytest.raises(InvalidData, match="too much alike"):
        direction_by_dynamics(uncertain.linear, loose, healthy=[healthy[0], healthy[0]])


def _seen(arm: Arm, pose: Array, link: int, direction: Array) -> Array:
    return np.asarray(ToolFrames(arm).images(pose)[0, link - 1] @ direction)


@pytest.fixture(scope="module")
def simulated() -> tuple[Arm, StructuralLooseness, list[Measurement], list[Measurement]]:
    """A geared arm whose masses, gears and sensors the model has wrong, loose and sound."""
    arm = geared(planar(3))
    fault = StructuralLooseness(
        link=2,
        direction=(0.6, 0.8, 0.0),
        gap=2e-4,
        stiffness=(2e5, 2e5),
        damping=(60.0, 60.0),
        friction=0.2,
    )
    rig, linear = SimulatedRig(arm), LinearArm(arm)
    draw = Mismatch().draw(arm, np.random.default_rng(11))
    pose = np.array([0.3, 1.0, -0.8])
    records: list[list[Measurement]] = []
    for state, hidden in enumerate((Healthy(), fault)):
        records.append([])
        rig.mount(0, hidden, draw)
        for j in range(arm.n):
            shake, _ = at_levels(
                linear.at(pose), np.where(np.arange(arm.n) == j, 3.0, 0.0), duration=1.2
            )
            rng = np.random.default_rng([state, j])
            records[state].append(rig.measure(pose, shake, rng=rng))
    return arm, fault, records[1], records[0]


@pytest.mark.parametrize("with_healthy", [True, False])
def test_a_simulated_arm_on_soft_gears_shows_link_and_direction(
    simulated: tuple[Arm, StructuralLooseness, list[Measurement], list[Measurement]],
    with_healthy: bool,
) -> None:
    arm, fault, loose, healthy = simulated
    found = direction_by_dynamics(LinearArm(arm), loose, healthy=healthy if with_healthy else None)
    assert found.location == "structural_looseness@link2"
    assert found.direction_in_link is not None
    assert degrees_between(found.direction_in_link, np.array(fault.direction[:2])) < 2.0
    assert found.evidence > 1000
    assert found.lack_of_fit < 1.5
    # A model whose gears do not give way cannot explain the records, and says so.
    stiff = LinearArm(planar(3))
    without = direction_by_dynamics(stiff, loose, healthy=healthy if with_healthy else None)
    assert without.lack_of_fit > 2.5


def test_a_sound_arm_gives_no_evidence(
    simulated: tuple[Arm, StructuralLooseness, list[Measurement], list[Measurement]],
) -> None:
    arm, _, _, healthy = simulated
    found: DynamicDirection = direction_by_dynamics(LinearArm(arm), healthy)
    assert found.evidence < 0


def test_what_cannot_be_used_is_refused() -> None:
    arm = geared(planar(3))
    uncertain = UncertainArm(LinearArm(arm, points=2), NONE)
    linear, pose = uncertain.linear, np.array([0.2, 0.9, -0.7])
    good = linear_record(uncertain, pose, [0])
    with pytest.raises(InvalidData, match="no record is given"):
        direction_by_dynamics(linear, [])
    with pytest.raises(UnknownName, match="links 1 to 3"):
        direction_by_dynamics(linear, [good], link=4)
    for wrong in (0.0, -1.0, float("nan")):
        with pytest.raises(InvalidSetting, match="relative and positive"):
            direction_by_dynamics(linear, [good], model_error=wrong)
    with pytest.raises(InvalidData, match="stopped"):
        direction_by_dynamics(linear, [dataclasses.replace(good, failure="it stopped")])
    quiet = dataclasses.replace(good.excitation, torque_rms=(0.0, 0.0, 0.0))
    with pytest.raises(InvalidData, match="no joint was excited"):
        direction_by_dynamics(linear, [dataclasses.replace(good, excitation=quiet)])
    shaken = dataclasses.replace(good.excitation, shaker_rms=1.0)
    with pytest.raises(InvalidData, match="shaker"):
        direction_by_dynamics(linear, [dataclasses.replace(good, excitation=shaken)])
    with pytest.raises(InvalidData, match="arm 'six_axis'"):
        direction_by_dynamics(LinearArm(six_axis(), points=2), [good])
    with pytest.raises(InvalidData, match="1 or more healthy records like it are needed, 0 given"):
        direction_by_dynamics(linear, [good], healthy=[linear_record(uncertain, pose, [1])])
    shorter = dataclasses.replace(
        good,
        command=good.command[:, :500],
        tool=good.tool[:, :500],
        encoder=good.encoder[:, :502],
    )
    with pytest.raises(InvalidData, match="lines lie elsewhere"):
        direction_by_dynamics(linear, [good], healthy=[shorter])


def test_a_broken_record_is_refused() -> None:
    arm = planar(2)
    shake = at_levels(LinearArm(arm).at([0.2, 0.9]), np.array([2.0, 0.0]), duration=0.2)[0]
    record = SimulatedRig(arm, threads=1).measure(np.array([0.2, 0.9]), shake)
    tool, encoder = record.tool, record.encoder
    for broken, why in (
        ({"tool": tool[:, :50]}, "cut off"),
        ({"tool": np.full_like(tool, np.nan)}, "tool of the record holds NaN"),
        ({"encoder": np.full_like(encoder, np.inf)}, "encoder of the record holds NaN"),
        ({"tool": np.zeros_like(tool)}, "accelerometer connected"),
    ):
        with pytest.raises(InvalidData, match=why):
            direction_by_dynamics(LinearArm(arm), [dataclasses.replace(record, **broken)])
