"""The slide rig answers as the thesis measured it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import find_peaks

from loose_env.arms import COIL, ShakenArm
from loose_env.arms.sites import ShakenResponse
from loose_env.excitation import Excitation
from loose_env.rig import SimulatedRig
from loose_env.sensors import Accelerometer, SensorSuite
from loose_env.statistics import axial_difference, lowest_correlation_direction
from loose_env.thesis.printed import printed
from loose_env.thesis.rigs.shaken_vera import SHAKEN_BAND
from loose_env.thesis.rigs.slide import SLIDE, Stinger, slide_rig


def answer(stinger: Stinger, band: tuple[float, float], step: float) -> ShakenResponse:
    arm = replace(slide_rig(stinger=stinger), band=band)
    points = round((band[1] - band[0]) / step) + 1
    return ShakenArm(arm, points=points).at([0.0])


def peaks(response: ShakenResponse, axis: int) -> list[float]:
    size = np.abs(response.probes[SLIDE][:, axis])
    return [float(f) for f in response.frequency[find_peaks(size)[0]]]


def test_the_rod_absorbs_the_coils_motion_at_the_slides_own_frequency():
    # The rod's stiffness is set by its resonance between slide and coil. That the slide alone on
    # that rod stops the coil, a factor sqrt(coil / (coil + slide)) lower, is not set anywhere.
    response = answer("threaded_rod", (300.0, 2000.0), 1.0)
    coil = np.abs(response.probes[COIL][:, 0])
    own = 710.0 * np.sqrt(0.39 / (0.39 + 0.50))
    assert response.frequency[np.argmin(coil)] == pytest.approx(own, rel=0.02)


def test_mass_on_the_slide_lowers_the_rods_resonance():
    # 0.40 kg of looseness joint instead of 0.15 kg of cube, on the rod that fits 710 Hz without it.
    arm = replace(slide_rig(looseness_angle=0.0, stinger="threaded_rod"), band=(300.0, 2000.0))
    found = peaks(ShakenArm(arm, points=1701).at([0.0]), 0)
    light, heavy, coil = 0.50, 0.50 + 0.40, 0.39
    lower = np.sqrt((1 / heavy + 1 / coil) / (1 / light + 1 / coil))
    assert found == [pytest.approx(printed("signals")["dominant_frequency_hz"] * lower, rel=0.02)]


def test_slide_and_coil_move_together_below_the_resonance_and_apart_above():
    response = answer("threaded_rod", (100.0, 1500.0), 1.0)
    ratio = response.probes[SLIDE][:, 0] / response.probes[COIL][:, 0]
    phase = np.degrees(np.abs(np.angle(ratio)))
    assert phase[response.frequency < 350].max() < 15.0
    assert phase[response.frequency > 600].min() > 165.0
    # In the band of Experiment Four the rod alone would raise 350 Hz over 100 Hz by this much.
    own = 710.0 * np.sqrt(0.39 / (0.39 + 0.50))
    rise = np.interp(350.0, response.frequency, np.abs(ratio)) / np.abs(ratio[0])
    assert rise == pytest.approx((1 - (100 / own) ** 2) / (1 - (350 / own) ** 2), rel=0.03)


def test_the_stiff_stinger_resonates_far_above_the_band():
    assert peaks(answer("stiff", (300.0, 2000.0), 1.0), 0) == []


def test_across_the_motion_the_bench_shows_its_modes():
    found = peaks(answer("threaded_rod", (30.0, 300.0), 0.1), 1)
    assert found == [pytest.approx(f, rel=0.01) for f in printed("signals")["bench_peaks_hz"]]


def test_the_slide_is_driven_weakly_below_40_hz():
    response = answer("threaded_rod", (10.0, 350.0), 1.0)
    size = np.abs(response.probes[SLIDE][:, 0])
    weak = response.frequency < printed("signals")["shaker_weak_below_hz"]
    middle = np.median(size[~weak])
    assert size[weak].max() < 0.7 * middle
    assert size[response.frequency <= 20].max() < 0.15 * middle


@pytest.mark.parametrize("degrees", [0.0, 30.0, 45.0, 80.0, 90.0, 130.0])
def test_healthy_lowest_correlation_lies_across_the_motion(degrees):
    angle = float(np.radians(degrees))
    sensors = SensorSuite(rate=2000.0, accelerometer=Accelerometer(bandwidth=900.0))
    rig = SimulatedRig(slide_rig(cube_angle=angle), sensors=sensors)
    shake = Excitation(torque_rms=(0.0,), duration=1.0, band=SHAKEN_BAND, shaker_rms=3.0)
    run = rig.measure(np.zeros(1), shake, rng=np.random.default_rng(3))
    assert run.failure is None
    found = lowest_correlation_direction(run.probes[SLIDE][0], run.tool)
    # The motion lies at -angle in the cube's frame.
    assert abs(np.degrees(axial_difference(found, np.pi / 2 - angle))) < 1.0


def test_the_looseness_joint_turns_the_link():
    beta = float(np.radians(309))
    response = ShakenArm(slide_rig(looseness_angle=beta), points=40).at([0.0])
    _, along, _ = response.covariances(SLIDE, 0)
    motion = np.arctan2(along[1], along[0])
    assert abs(np.degrees(axial_difference(float(motion), -beta))) < 1.0
