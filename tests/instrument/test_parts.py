"""Parts of the instrument: signals, knocks, gears and what repeats."""

from __future__ import annotations

import numpy as np
import pytest

from loose_env.arms import SIX_AXIS_SERVO_ARM
from loose_env.errors import InvalidSetting
from loose_env.instrument import PRESETS, PlanSettings, SuspectArm, commands_of, plan, read_arm
from loose_env.instrument.knocks import knocks, rung, sphere
from loose_env.instrument.locate import correlation
from loose_env.instrument.motion import links_of, wave
from loose_env.instrument.signals import multisine


@pytest.fixture(scope="module")
def arm() -> SuspectArm:
    return read_arm(SIX_AXIS_SERVO_ARM)


def test_lines_are_odd_and_some_are_left_out() -> None:
    signal = multisine(3, 25.0, np.random.default_rng(1))
    assert (signal.excited % 2 == 1).all() and (signal.silent % 2 == 1).all()
    assert not set(signal.excited) & set(signal.silent) and len(signal.silent) >= 3
    waves = signal.accelerations(np.array([1.0, 2.0, 3.0]), 1000)
    np.testing.assert_allclose(np.abs(waves).max(0), [1, 2, 3], rtol=1e-3)
    share = np.abs(np.fft.rfft(waves, axis=0)[signal.silent]).max()
    assert share < 1e-6 * np.abs(np.fft.rfft(waves, axis=0)).max()


@pytest.mark.parametrize("commands", ["position", "velocity"])
@pytest.mark.parametrize("controller", list(PRESETS))
def test_a_plan_keeps_the_limits(controller: str, commands: str) -> None:
    own = PlanSettings(controller=controller, commands=commands, poses=3, rate_hz=1000.0)
    made, arm = plan(SIX_AXIS_SERVO_ARM, own)
    limits = own.limits
    for run in made.runs:
        time, played = commands_of(made, arm, run)
        rate = 1 / (time[1] - time[0])
        speed = np.diff(played, axis=0) * rate if commands == "position" else played
        # While it swells a little more than in the periods.
        assert np.abs(speed).max() <= 1.1 * limits.max_speed_rad_s[0]
        late = speed[round(0.5 * rate) :]
        assert np.abs(np.diff(late, axis=0)).max() * rate <= (
            1.02 * limits.max_acceleration_rad_s2[0]
        )
        if commands == "position":
            assert (played >= arm.low).all() and (played <= arm.high).all()


def test_a_mass_between_two_stops_arrives_when_it_must() -> None:
    # Constant load L: the mass crosses the gap g in sqrt(2 g m / L) and arrives at 2 g L / m.
    n, period = 4000, 1.0
    load = np.where(np.arange(n) < n // 2, 10.0, -10.0)[None]
    energy = knocks(load, np.array([2.0]), np.array([1e-3]), np.zeros(1), period)[0]
    hits = np.flatnonzero(energy)
    late = np.sqrt(2 * 1e-3 * 2 / 10)
    np.testing.assert_allclose(hits * period / n, [late, 0.5 + late], atol=1e-3)
    np.testing.assert_allclose(energy[hits], 2 * 1e-3 * 10 / 2, rtol=0.05)
    held = knocks(load, np.array([2.0]), np.array([1e-3]), np.array([11.0]), period)
    assert not held.any()


def test_ringing_decays_around_the_period() -> None:
    energy = np.zeros((1, 1000))
    energy[0, 990] = 1.0
    rings = rung(energy, 0.005, 1.0)[0]
    assert rings[990] == pytest.approx(1.0) and rings[995] == pytest.approx(np.exp(-1), rel=1e-3)
    assert rings[5] == pytest.approx(np.exp(-3), rel=1e-2)


def test_directions_cover_half_the_sphere() -> None:
    grid = sphere(240)
    np.testing.assert_allclose(np.linalg.norm(grid, axis=1), 1)
    rng = np.random.default_rng(0)
    tried = rng.normal(size=(500, 3))
    tried /= np.linalg.norm(tried, axis=1, keepdims=True)
    assert np.degrees(np.arccos(np.abs(tried @ grid.T).max(1).min())) < 9


def test_correlation_takes_off_what_friction_explains() -> None:
    rng = np.random.default_rng(3)
    friction, knock = rng.random((1, 1000)), rng.random((1, 1000))
    heard = 3 * friction[0] + knock[0]
    told = [np.vstack([knock, friction])]
    found, moments, share, chance = correlation([heard], told, [friction], np.array([[300], [500]]))
    assert abs(chance) < 0.2
    assert found[0] == pytest.approx(1.0) and found[1] == 0.0 and share > 0.8
    assert moments.shape == (1, 3, 2)


def test_links_on_springs_resonate(arm: SuspectArm) -> None:
    model = arm.at(np.zeros(arm.n))
    free = 1 / np.diag(np.linalg.inv(model.inertia))
    spring = free * (2 * np.pi * 1000.0) ** 2
    still = links_of(np.ones((1, arm.n), complex), model, spring, 0 * free, np.array([5.0]), 0.0)
    np.testing.assert_allclose(still, 1, rtol=1e-3)
    lines = np.zeros((4, 1), complex)
    lines[2] = 3.0
    np.testing.assert_allclose(np.abs(wave(lines)).max(), 3.0, rtol=1e-3)


def test_rigid_dynamics_agree_with_weights(arm: SuspectArm) -> None:
    pose = np.array([0.3, -1.2, 1.1, 0.2, 0.6, 0.1])
    model = arm.at(pose)
    np.testing.assert_allclose(np.linalg.norm(model.weight, axis=1), 9.81 * model.mass, rtol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(model.up), 9.81)
    np.testing.assert_allclose(model.inertia, model.inertia.T, atol=1e-9)
    throws, stiff, _ = model.throws(np.zeros(arm.n))
    assert throws.shape == (6, 3, 3) and (np.linalg.eigvalsh(stiff) > -1e-9).all()


@pytest.mark.parametrize(
    ("own", "says"),
    [
        ({"levels": (1.0, 0.5)}, "levels go upwards"),
        ({"levels": (0.0,)}, "above 0"),
        ({"max_speed_rad_s": (-1.0,)}, "one positive number"),
        ({"max_speed_rad_s": (1.0, 1.0)}, "one value for all joints"),
        ({"low": (0.0,)}, "one position for each"),
        ({"low": (3.0,) * 6}, "has no room"),
        ({"commands": "force"}, "position, velocity or torque"),
        ({"corner_hz": 0.0}, "above 0 Hz"),
    ],
)
def test_settings_that_make_no_sense_are_refused(own: dict, says: str) -> None:
    with pytest.raises(InvalidSetting, match=says):
        plan(SIX_AXIS_SERVO_ARM, PlanSettings(**own))
