"""A slot's readings depend on its arm and its job alone, and on a healthy arm are the predicted."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from loose_env.arms import Arm, LinearArm, Mismatch, MismatchDraw, planar, scara, six_axis, vera
from loose_env.diagnosis import SensorFloor, predict, statistics_of
from loose_env.errors import InvalidSetting, UnknownName
from loose_env.excitation import Excitation, at_levels
from loose_env.faults import (
    Backlash,
    Fault,
    Healthy,
    Preload,
    RotationalLooseness,
    SeveralFaults,
    StructuralLooseness,
)
from loose_env.rig import Measurement, SimulatedRig
from loose_env.sensors import Accelerometer, Encoder, SensorSuite
from loose_env.typing import Array

POSE = np.array([0.3, -0.7])
SHAKE = Excitation(torque_rms=(3.0, 1.0), duration=0.2, band=(30.0, 150.0))
ONE_JOINT = Excitation(torque_rms=(3.0, 0.0), duration=0.2, band=(30.0, 150.0))
LOOSE = StructuralLooseness(
    link=1,
    direction=(1.0, 2.0, 0.0),
    gap=1e-4,
    stiffness=(3e5, 2e5),
    damping=(20.0, 40.0),
    friction=0.5,
)
PLAY = Backlash(joint=2, gap=4e-4, stiffness=(3e3, 5e3), damping=(0.2, 0.4), friction=0.05)
ROCK = RotationalLooseness(
    link=2,
    axis=(0.0, 0.0, 1.0),
    pivot=(0.02, 0.03, 0.0),
    gap=4e-4,
    stiffness=(3e3, 5e3),
    damping=(0.2, 0.4),
    friction=0.05,
)
BOX = SeveralFaults(faults=(LOOSE, ROCK))
FAULTS: dict[str, Fault] = {
    "slide": LOOSE,
    "play": PLAY,
    "rotation": ROCK,
    "several": BOX,
    "healthy": Healthy(),
}


Trial = tuple[int, Array, Excitation, np.random.Generator]


def trial(
    slot: int = 0, *, seed: int = 0, pose: Array = POSE, excitation: Excitation = SHAKE
) -> Trial:
    return slot, pose, excitation, np.random.default_rng(seed)


def measured(rig: SimulatedRig, trials: Sequence[Trial]) -> list[Measurement]:
    return rig.measure_all(*zip(*trials, strict=True))


def true_arm(seed: int = 1) -> MismatchDraw:
    return Mismatch().draw(planar(2), np.random.default_rng(seed))


def assert_same(one: Measurement, other: Measurement) -> None:
    assert one.failure == other.failure
    assert one.rate == other.rate
    np.testing.assert_array_equal(one.pose, other.pose)
    for name in ("command", "encoder", "tool"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
    assert (one.links is None) == (other.links is None)
    if one.links is not None and other.links is not None:
        np.testing.assert_array_equal(one.links, other.links)


@pytest.fixture(scope="module", params=FAULTS.values(), ids=FAULTS)
def alone(request: pytest.FixtureRequest) -> tuple[Fault, Measurement]:
    """A fault, and its arm measured on a rig of its own."""
    rig = SimulatedRig(planar(2), threads=1)
    rig.mount(0, request.param, true_arm())
    measurement = measured(rig, [trial()])[0]
    assert measurement.failure is None
    return request.param, measurement


@pytest.mark.parametrize("threads", [1, 2, 4])
def test_readings_do_not_depend_on_slot_neighbours_order_or_threads(
    alone: tuple[Fault, Measurement], threads: int
) -> None:
    fault, expected = alone
    rig = SimulatedRig(planar(2), slots=5, threads=threads)
    neighbours = [LOOSE, BOX, Healthy(), PLAY, BOX]
    for slot in (0, 4, 2):
        for other, neighbour in enumerate(neighbours):
            rig.mount(other, neighbour, true_arm(10 + other))
        rig.mount(slot, fault, true_arm())
        order = [3, 0, 4, 1, 2]
        trials = [trial(other, seed=20 + other, pose=POSE * other) for other in order]
        trials[order.index(slot)] = trial(slot)
        assert_same(measured(rig, trials)[order.index(slot)], expected)


def test_readings_do_not_depend_on_what_was_measured_before(
    alone: tuple[Fault, Measurement],
) -> None:
    fault, expected = alone
    rig = SimulatedRig(planar(2), slots=2)
    rig.mount(1, fault, true_arm())
    measured(rig, [trial(0, seed=5), trial(1, seed=6, pose=-2 * POSE, excitation=ONE_JOINT)])
    longer = dataclasses.replace(SHAKE, duration=0.3)
    measured(rig, [trial(1, seed=7, excitation=longer)])
    assert_same(measured(rig, [trial(1)])[0], expected)
    rig.mount(1, PLAY, true_arm(9))
    measured(rig, [trial(1)])
    rig.mount(1, fault, true_arm())
    assert_same(measured(rig, [trial(1)])[0], expected)


def test_records_of_several_lengths_can_be_taken_at_once(
    alone: tuple[Fault, Measurement],
) -> None:
    fault, expected = alone
    rig = SimulatedRig(planar(2), slots=3)
    rig.mount(1, fault, true_arm())
    longer = dataclasses.replace(SHAKE, duration=0.3)
    found = measured(rig, [trial(2, excitation=longer), trial(1), trial(0, excitation=longer)])
    assert [m.tool.shape[1] for m in found] == [300, 200, 300]
    assert_same(found[1], expected)


def test_more_arms_than_one_call_simulates_are_each_measured_alike() -> None:
    arm, brief = planar(2), dataclasses.replace(SHAKE, duration=0.04)
    rig = SimulatedRig(arm, slots=70)
    seeds = np.random.default_rng(0).permutation(70)
    found = measured(rig, [trial(int(s), seed=int(s), excitation=brief) for s in seeds])
    single = SimulatedRig(arm)
    for seed, measurement in zip(seeds[::9], found[::9], strict=True):
        assert_same(measurement, measured(single, [trial(seed=int(seed), excitation=brief)])[0])


def test_a_single_measurement_is_one_of_many() -> None:
    rig = SimulatedRig(planar(2), slots=2)
    single = rig.measure(POSE, SHAKE, rng=np.random.default_rng(0), slot=1)
    assert_same(single, measured(rig, [trial(1)])[0])


def test_channels_have_the_stated_shapes() -> None:
    suite = SensorSuite(link_accelerometers=True)
    found = SimulatedRig(planar(3), sensors=suite).measure(
        np.zeros(3), Excitation(torque_rms=(2.0, 0.0, 1.0), duration=0.2, band=(30.0, 150.0))
    )
    assert found.command.shape == (3, 200)
    assert found.encoder.shape == (3, 202)
    assert found.tool.shape == (2, 200)
    assert found.links is not None
    assert found.links.shape == (3, 2, 200)
    assert found.excited.tolist() == [True, False, True]
    assert not found.command[1].any()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"slots": 0}, "at least one slot, got 0"),
        ({"slots": True}, "at least one slot, got True"),
        ({"timestep": 3e-4}, "1000 Hz must be a whole fraction of the simulation's 3333.33 Hz"),
        ({"timestep": 2e-3}, "1000 Hz must be a whole fraction of the simulation's 500 Hz"),
    ],
)
def test_a_rig_that_cannot_be_is_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidSetting, match=message):
        SimulatedRig(planar(2), **change)


@pytest.mark.parametrize(
    ("trials", "message"),
    [
        ([trial(1), trial(1)], r"each slot.*\[1, 1\]"),
        ([trial(pose=np.zeros(3))], r"needs 2 joint positions and 2 torques, got \(3,\) and 2"),
        (
            [trial(excitation=dataclasses.replace(SHAKE, torque_rms=(1.0,)))],
            r"needs 2 joint positions and 2 torques, got \(2,\) and 1",
        ),
    ],
)
def test_a_measurement_that_cannot_be_done_is_refused(
    trials: Sequence[Trial], message: str
) -> None:
    with pytest.raises(InvalidSetting, match=message):
        measured(SimulatedRig(planar(2), slots=2), trials)


def test_a_fault_in_a_link_the_arm_lacks_is_refused() -> None:
    with pytest.raises(UnknownName, match=r"links 1 to 2.*got 3"):
        SimulatedRig(planar(2)).mount(0, dataclasses.replace(LOOSE, link=3))


# --- the healthy arm against its closed form


def levels_of(arm: Arm, *excited: int) -> Array:
    levels = np.zeros(arm.n)
    levels[list(excited)] = arm.levels[0]
    return levels


SETTLED: dict[str, tuple[Arm, tuple[int, ...]]] = {
    "planar2 joint 1": (planar(2), (0,)),
    "planar2 both": (planar(2), (0, 1)),
    "planar4 joints 1 and 4": (planar(4), (0, 3)),
    "vertical all": (planar(3, vertical=True), (0, 1, 2)),
    **{f"scara joint {j + 1}": (scara(), (j,)) for j in range(4)},
    **{f"six_axis joint {j + 1}": (six_axis(), (j,)) for j in range(6)},
}
"""Arms whose modes lie far above the band: their records hold no transient."""
RINGING: dict[str, tuple[Arm, tuple[int, ...]]] = {
    "planar2 joint 1": (planar(2), (0,)),
    "planar2 servo joint 1": (planar(2, hold="servo"), (0,)),
    "planar4 servo joint 3": (planar(4, hold="servo"), (2,)),
    "vera both": (vera(), (0, 1)),
    "vera servo joint 2": (vera(hold="servo"), (1,)),
}
QUIET = SensorFloor(joint=0.0, tool=0.0)
RECORDS = 6


@pytest.mark.parametrize("case", RINGING)
def test_a_healthy_nominal_arm_transmits_what_its_closed_form_says(case: str) -> None:
    arm, excited = RINGING[case]
    # The simulation's damping acts half a step late: a servo's takes off up to c h / 2 of the
    # inertia that it holds, a brake's nothing to speak of.
    allowed = 0.005
    if case == "planar4 servo joint 3":
        arm = dataclasses.replace(arm, timestep=arm.timestep / 2)
    rig = SimulatedRig(arm, slots=RECORDS, sensors=SensorSuite.ideal())
    linear = LinearArm(arm)
    poses = np.random.default_rng(3)
    for _ in range(2):
        at = linear.at(0.8 * arm.random_pose(poses))
        excitation, share = at_levels(at, levels_of(arm, *excited), duration=1.2)
        assert share.min() == 1.0
        records = measured(
            rig, [trial(k, seed=k, pose=at.pose, excitation=excitation) for k in range(RECORDS)]
        )
        found = np.array([statistics_of(r).transmission[:, list(excited)] for r in records])
        expected = predict(at, excitation, QUIET).transmission
        scatter = found.std(axis=0, ddof=1) / np.sqrt(RECORDS)
        error = np.abs(found.mean(axis=0) - expected)
        assert (error < 4 * scatter + allowed * np.linalg.norm(expected)).all()


@pytest.mark.parametrize("case", SETTLED)
def test_every_line_of_a_healthy_record_is_as_the_closed_form_says(case: str) -> None:
    # No sampling error here: the drawn torque is known, line by line.
    arm, excited = SETTLED[case]
    linear = LinearArm(arm, points=145)
    pose = np.where(arm.sliding, -0.08, np.linspace(0.2, 0.9, arm.n))
    at = linear.at(pose)
    excitation, _ = at_levels(at, levels_of(arm, *excited), duration=1.2)
    record = SimulatedRig(arm, sensors=SensorSuite.ideal()).measure(at.pose, excitation)
    lines = slice(36, 181)
    np.testing.assert_allclose(np.fft.rfftfreq(1200, 1e-3)[lines], linear.frequency)
    torque = np.fft.rfft(record.command[list(excited)])[:, lines]
    tool = np.fft.rfft(record.tool)[:, lines]
    expected = np.einsum("kdm,mk->dk", at.response(excitation.excited).tool, torque)
    assert np.linalg.norm(tool - expected) < 0.01 * np.linalg.norm(expected)


def test_a_preloaded_seat_looks_healthy() -> None:
    arm = planar(2)
    at = LinearArm(arm).at(POSE)
    excitation, _ = at_levels(at, levels_of(arm, 0), duration=1.2)
    rig = SimulatedRig(arm, slots=3, sensors=SensorSuite.ideal())
    # 0.8 kHz with all that hangs on the seat, far above the band, and its softer cousin inside it.
    carried = arm.model.body_mass.sum()
    for slot, mode in ((1, 800.0), (2, 100.0)):
        stiffness = carried * (2 * np.pi * mode) ** 2
        rig.mount(
            slot,
            Preload(
                link=1,
                direction=(1.0, 2.0, 0.0),
                stiffness=stiffness,
                damping=0.02 * np.sqrt(stiffness * carried),
            ),
        )
    records = measured(rig, [trial(s, pose=POSE, excitation=excitation) for s in range(3)])
    healthy, stiff, soft = (statistics_of(r).transmission[:, 0] for r in records)
    assert np.linalg.norm(stiff - healthy) < 0.05 * np.linalg.norm(healthy)
    assert np.linalg.norm(soft - healthy) > 0.1 * np.linalg.norm(healthy)


# --- simulations that diverge


def nan_mass(model: mujoco.MjModel) -> None:
    model.body_mass[1] = np.nan


def absurd_damping(model: mujoco.MjModel) -> None:
    model.dof_damping[0] = 1e9


def infinite_gravity(model: mujoco.MjModel) -> None:
    model.opt.gravity[:] = np.inf


@pytest.mark.parametrize(
    ("poison", "threads"), [(nan_mass, 1), (absurd_damping, 4), (infinite_gravity, 4)]
)
def test_a_diverging_arm_fails_alone_and_in_silence(
    poison: Callable[[mujoco.MjModel], None],
    threads: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    rig = SimulatedRig(planar(2), slots=4, threads=threads)
    for slot, fault in enumerate((LOOSE, PLAY, Healthy(), LOOSE)):
        rig.mount(slot, fault, true_arm(slot))
    slots = [0, 1, 2, 3]
    before = measured(rig, [trial(s, seed=s) for s in slots])
    assert [m.failure for m in before] == [None] * 4
    poison(rig.plants[1].model)
    after = measured(rig, [trial(s, seed=s) for s in slots])
    assert after[1].failure is not None
    assert after[1].failure.startswith("the simulation ")
    assert not after[1].tool.any()
    assert not after[1].encoder.any()
    for slot in (0, 2, 3):
        assert_same(after[slot], before[slot])
    # A new arm in the slot is as good as any.
    rig.mount(1, PLAY, true_arm(1))
    assert_same(measured(rig, [trial(1, seed=1)])[0], before[1])
    captured = capfd.readouterr()
    assert captured.err == ""
    assert captured.out == ""
    assert list(tmp_path.iterdir()) == []


def test_a_failed_record_has_the_shapes_of_a_good_one() -> None:
    rig = SimulatedRig(planar(2), sensors=SensorSuite(link_accelerometers=True))
    good = measured(rig, [trial()])[0]
    nan_mass(rig.plants[0].model)
    bad = measured(rig, [trial()])[0]
    assert bad.failure is not None
    for name in ("command", "encoder", "tool", "links"):
        assert getattr(bad, name).shape == getattr(good, name).shape
    np.testing.assert_array_equal(bad.command, good.command)


def test_mujoco_s_own_warnings_are_as_they_were_after_a_measurement(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    rig = SimulatedRig(planar(2))
    nan_mass(rig.plants[0].model)
    measured(rig, [trial()])
    data = mujoco.MjData(rig.plants[0].model)
    mujoco.mj_step(rig.plants[0].model, data)
    assert "WARNING" in capfd.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["MUJOCO_LOG.TXT"]


# --- what the sensors of the rig make of the motion


def nothing_but(**changes: Any) -> MismatchDraw:
    return dataclasses.replace(MismatchDraw.none(planar(2)), **changes)


def test_gain_and_cross_axis_of_the_mismatch_reach_the_readings() -> None:
    matrix = np.array([[1.02, 0.03, 0.5], [-0.01, 0.97, -0.2], [0.0, 0.0, 1.0]])
    rig = SimulatedRig(planar(2), slots=2, sensors=SensorSuite.ideal())
    rig.mount(1, Healthy(), nothing_but(sensor=matrix))
    true, read = (m.tool for m in measured(rig, [trial(0), trial(1)]))
    # The plane is horizontal: the third axis feels gravity and no motion.
    expected = matrix[:2, :2] @ true + matrix[:2, 2:] * 9.81
    np.testing.assert_allclose(read, expected, rtol=0, atol=1e-6)


def test_a_drive_gain_scales_the_motion_and_not_the_command() -> None:
    rig = SimulatedRig(planar(2), slots=2, sensors=SensorSuite.ideal())
    rig.mount(1, Healthy(), nothing_but(drive_gain=np.array([1.1, 1.1])))
    nominal, strong = measured(rig, [trial(0), trial(1)])
    np.testing.assert_array_equal(strong.command, nominal.command)
    assert strong.tool.std() == pytest.approx(1.1 * nominal.tool.std(), rel=0.02)


def test_a_joint_zero_shifts_the_true_pose_and_not_the_encoder() -> None:
    zero = np.array([0.02, -0.05])
    rig = SimulatedRig(planar(2), slots=2, sensors=SensorSuite.ideal())
    rig.mount(0, Healthy(), nothing_but(joint_zero=zero))
    shifted, there = measured(rig, [trial(0), trial(1, pose=POSE + zero)])
    np.testing.assert_allclose(shifted.encoder + zero[:, None], there.encoder, atol=1e-12)
    np.testing.assert_allclose(shifted.tool, there.tool, atol=1e-9)


def test_sensors_add_no_more_than_they_state() -> None:
    real = SensorSuite(
        accelerometer=Accelerometer(noise_density=5e-3, resolution=2e-2),
        encoder=Encoder(resolution=1e-5, noise=2e-5),
    )
    (exact,), (read,) = (
        measured(SimulatedRig(planar(2), sensors=suite), [trial()])
        for suite in (SensorSuite.ideal(), real)
    )
    tool, encoder = read.tool - exact.tool, read.encoder - exact.encoder
    assert tool.std() == pytest.approx(np.hypot(5e-3 * np.sqrt(500), 2e-2 / np.sqrt(12)), rel=0.15)
    assert encoder.std() == pytest.approx(np.hypot(2e-5, 1e-5 / np.sqrt(12)), rel=0.15)
    for values, step in ((read.tool, 2e-2), (read.encoder, 1e-5)):
        np.testing.assert_allclose(values / step, np.round(values / step), atol=1e-6)
