"""The torque played is the band-limited Gaussian noise that was asked for."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from loose_env.arms import LinearArm, planar, vera
from loose_env.errors import InvalidSetting
from loose_env.excitation import (
    CREST_FACTOR,
    Excitation,
    SeatDrive,
    at_levels,
    torque_periods,
)
from loose_env.rig import SimulatedRig
from loose_env.rig.simulated import Controls
from loose_env.sensors import SensorSuite
from loose_env.typing import Array, IndexArray

BAND = (30.0, 150.0)
STEP = 5e-4


def shake(*rms: float, duration: float = 1.2, **settings: Any) -> Excitation:
    return Excitation(torque_rms=rms, duration=duration, band=BAND, **settings)


def periods(
    excitation: Excitation, seed: int = 0, *, step: float = STEP
) -> tuple[Array, IndexArray, IndexArray]:
    return torque_periods(
        np.array([excitation.torque_rms]),
        np.zeros(1),
        duration=excitation.duration,
        band=excitation.band,
        timestep=step,
        rngs=[np.random.default_rng(seed)],
        shaping=[excitation.shaping],
    )


def drawn(excitation: Excitation, seed: int = 0, *, step: float = STEP) -> Array:
    rows, _, joints = periods(excitation, seed, step=step)
    torque = np.zeros((len(excitation.torque_rms), rows.shape[1]))
    torque[joints] = rows
    return torque


def lines(torque: Array, step: float = STEP) -> tuple[Array, Array]:
    """Frequencies of a record's Fourier lines and the magnitude of each."""
    count = torque.shape[-1]
    return np.fft.rfftfreq(count, step), np.abs(np.fft.rfft(torque)) / count


def test_nothing_lies_outside_the_band() -> None:
    frequency, magnitude = lines(drawn(shake(2.0, 1.0)))
    inside = (frequency >= BAND[0] - 1e-9) & (frequency <= BAND[1] + 1e-9)
    assert inside.sum() == 145
    assert (magnitude[:, inside] > 0).all()
    assert magnitude[:, ~inside].max() < 1e-12


def test_the_spectrum_is_flat_within_the_band() -> None:
    draws = [lines(drawn(shake(2.0), seed))[1][0, 36:181] for seed in range(400)]
    power = np.mean(np.square(draws), axis=0)
    # Each line's power is exponential: its mean over 400 draws has a deviation of 5 %.
    np.testing.assert_allclose(power / power.mean(), 1.0, atol=0.25)
    thirds = [part.mean() for part in np.array_split(power, 3)]
    np.testing.assert_allclose(thirds / power.mean(), 1.0, atol=0.03)


def test_the_rms_is_the_one_asked_for() -> None:
    draws = np.array([drawn(shake(2.0, 0.5), seed) for seed in range(300)])
    np.testing.assert_allclose(np.sqrt(np.mean(draws**2, axis=(0, 2))), [2.0, 0.5], rtol=0.02)


def test_the_torque_is_gaussian() -> None:
    draws = np.concatenate([drawn(shake(1.0), seed)[0] for seed in range(200)])
    assert abs(np.mean(draws**3)) < 0.05
    assert np.mean(draws**4) == pytest.approx(3.0, abs=0.15)


def test_joints_are_independent() -> None:
    pairs = np.array([drawn(shake(1.0, 1.0), seed) for seed in range(200)])
    correlation = np.mean(pairs[:, 0] * pairs[:, 1])
    # 200 records of about 290 independent samples each.
    assert abs(correlation) < 4 / np.sqrt(200 * 290)


def test_a_joint_s_torque_does_not_depend_on_which_others_are_on() -> None:
    both = drawn(shake(1.0, 2.0))
    np.testing.assert_array_equal(drawn(shake(0.0, 2.0)), [0 * both[0], both[1]])
    np.testing.assert_array_equal(drawn(shake(1.0, 0.0)), [both[0], 0 * both[1]])


def test_a_held_joint_has_no_torque() -> None:
    excitation = shake(1.0, 0.0)
    assert excitation.excited == (True, False)
    assert not drawn(excitation)[1].any()


def test_the_draw_follows_the_generator() -> None:
    np.testing.assert_array_equal(drawn(shake(1.0), 3), drawn(shake(1.0), 3))
    assert not np.allclose(drawn(shake(1.0), 3), drawn(shake(1.0), 4))


@pytest.mark.parametrize("factor", [2, 5])
def test_a_finer_step_samples_the_same_torque(factor: int) -> None:
    coarse, fine = drawn(shake(1.0, 2.0)), drawn(shake(1.0, 2.0), step=STEP / factor)
    np.testing.assert_allclose(fine[:, ::factor], coarse, atol=1e-12)


def test_run_in_and_run_out_continue_the_record_s_period() -> None:
    rows, records, drives = periods(shake(1.0))
    still = np.zeros((1, 1))
    played = Controls(periods=rows, records=records, drives=drives, constant=still, gravity=still)
    around = played.signals(drives=1, before=300, after=50)[0].T
    record = drawn(shake(1.0))
    np.testing.assert_array_equal(around[:, 300:-50], record)
    np.testing.assert_array_equal(around[:, :300], record[:, -300:])
    np.testing.assert_array_equal(around[:, -50:], record[:, :50])


def test_a_shape_weighs_the_spectrum_and_keeps_the_rms() -> None:
    def rising(at: Array) -> Array:
        return at / 30.0

    draws = np.array([drawn(shake(2.0, shaping=(rising,)), seed)[0] for seed in range(300)])
    assert np.sqrt(np.mean(draws**2)) == pytest.approx(2.0, rel=0.02)
    frequency, _ = lines(draws)
    power = np.mean(lines(draws)[1] ** 2, axis=0)[36:181]
    expected = frequency[36:181] ** 2
    low, high = power[:48].sum() / power.sum(), power[-48:].sum() / power.sum()
    assert low == pytest.approx(expected[:48].sum() / expected.sum(), rel=0.1)
    assert high == pytest.approx(expected[-48:].sum() / expected.sum(), rel=0.1)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"torque_rms": (-1.0,)}, r"torque_rms must be .*finite number, zero or more.*\(-1.0,\)"),
        ({"torque_rms": (float("nan"),)}, "torque_rms must be .*finite.*nan"),
        ({"duration": 0.0}, "duration must be positive seconds; got 0.0"),
        ({"duration": float("inf")}, "duration must be positive seconds; got inf"),
        ({"band": (0.0, 100.0)}, r"0 < low < high in Hz, got \(0.0, 100.0\)"),
        ({"band": (150.0, 30.0)}, r"0 < low < high in Hz, got \(150.0, 30.0\)"),
        ({"duration": 0.02}, "fewer than 4 independent lines"),
        ({"shaping": (None, None)}, "one entry for each of 1 joints, got 2"),
    ],
)
def test_an_excitation_that_cannot_be_played_is_refused(
    settings: dict[str, Any], message: str
) -> None:
    fine: dict[str, Any] = {"torque_rms": (1.0,), "duration": 1.2, "band": BAND}
    with pytest.raises(InvalidSetting, match=message):
        Excitation(**{**fine, **settings})


def test_a_band_beyond_half_the_sampling_rate_is_refused() -> None:
    with pytest.raises(InvalidSetting, match=r"\(30.0, 150.0\) Hz reaches half.*rate, 125 Hz"):
        drawn(shake(1.0), step=4e-3)


# --- levels at the tool


@pytest.mark.parametrize("joint", [0, 1])
def test_a_level_is_the_rms_acceleration_of_the_nominal_tool(joint: int) -> None:
    arm = planar(2)
    levels = np.zeros(2)
    levels[joint] = 4.0
    at = LinearArm(arm).at([0.3, 0.8])
    excitation, share = at_levels(at, levels, duration=1.2)
    assert share.tolist() == [1.0, 1.0]
    rig = SimulatedRig(arm, slots=8, sensors=SensorSuite.ideal())
    rngs = [np.random.default_rng(s) for s in range(8)]
    records = rig.measure_all(range(8), at.pose, excitation, rngs)
    power = np.mean([np.sum(np.var(record.tool, axis=1)) for record in records])
    assert np.sqrt(power) == pytest.approx(4.0, rel=0.05)


def test_a_level_beyond_the_drive_is_cut_and_said_so() -> None:
    arm = vera()
    at = LinearArm(arm).at([0.0, 0.5])
    excitation, share = at_levels(at, np.array([1000.0, 0.0]), duration=1.2)
    assert excitation.torque_rms == pytest.approx((arm.torque_limits[0] / CREST_FACTOR, 0.0))
    full, _ = at_levels(at, np.array([1.0, 0.0]), duration=1.2)
    assert share[0] == pytest.approx(excitation.torque_rms[0] / (1000 * full.torque_rms[0]))
    assert share[1] == 1.0


def test_gravity_takes_its_part_of_the_drive() -> None:
    arm = planar(3, vertical=True)
    linear = LinearArm(arm)
    flat, hanging = linear.at([0.0, 0.0, 0.0]), linear.at([-np.pi / 2, 0.0, 0.0])
    level = np.array([1e4, 0.0, 0.0])
    loaded, free = (at_levels(at, level, duration=1.2)[0].torque_rms[0] for at in (flat, hanging))
    assert free == pytest.approx(arm.torque_limits[0] / CREST_FACTOR)
    load = abs(flat.gravity_torque[0])
    assert loaded == pytest.approx((arm.torque_limits[0] - load) / CREST_FACTOR)


@pytest.mark.parametrize("bad", [[1.0], [1.0, -1.0], [1.0, float("nan")], [[1.0, 1.0]]])
def test_levels_that_do_not_fit_the_arm_are_refused(bad: Any) -> None:
    at = LinearArm(planar(2)).at([0.0, 0.5])
    with pytest.raises(InvalidSetting, match="levels of 'planar2' are 2 numbers, zero or more"):
        at_levels(at, bad, duration=1.2)


def test_the_seat_drive_of_a_slide_is_the_force_that_it_transmits() -> None:
    arm = planar(3)
    drive = SeatDrive(LinearArm(arm), poses=8)
    across, along = drive.slide(3, (0.0, 1.0, 0.0)), drive.slide(3, (1.0, 0.0, 0.0))
    assert 0 < along < across  # link 3 is shaken across its length above all
    assert drive.slide(3, (0.0, -2.0, 0.0)) == pytest.approx(across)
    # A seat nearer to the base carries more of the arm.
    assert drive.hinges[0] > drive.hinges[1] > drive.hinges[2] > 0
