"""What runs can show, where a residual is and goes with, and errors over longer horizons."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from loose_env.gap import Hypothesis, Identifiability, JointMotion, how_to_see, main_band, strongest
from loose_env.gap.data.aligned_run import Channel, Trial, align_run, channels_of
from loose_env.gap.diagnostics.experiment_advice import identifiability_notes
from loose_env.gap.diagnostics.identifiability import identifiability
from loose_env.gap.diagnostics.joint_torque_residual import joint_motion
from loose_env.gap.diagnostics.localisation import locate, location_notes
from loose_env.gap.diagnostics.prediction_horizon import HorizonError, horizon_errors
from loose_env.gap.diagnostics.residual_tests import residual_tests
from loose_env.gap.model.effect import Effect
from loose_env.gap.model.effects.catalogue import CATALOGUE, candidates
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.output.evidence_schema import (
    Location,
    ResidualTest,
)
from loose_env.gap.residuals.residual_model import ResidualModel, Rows
from loose_env.gap.simulation.simulator import Simulator
from loose_env.recording import Run
from loose_env.statistics import channel_floor
from loose_env.typing import Array
from tests.gap.cases.effect_arms import PLANAR
from tests.gap.cases.gap_case import stated

RK4 = int(mujoco.mjtIntegrator.mjINT_RK4)


STEP = 0.002
MACHINE = NominalModel(mujoco.MjSpec.from_string(PLANAR), step=STEP, integrator=RK4)
ENCODERS = tuple(Channel(f"sensor.encoder{j}") for j in (1, 2, 3))
Pair = tuple[Effect, Array]


def seen(
    wave: Array, kinds: list[str], *pairs: Pair, machine: NominalModel = MACHINE
) -> Identifiability:
    """What a run under these commands of an arm with some effects, and noise, can show."""
    count = len(wave)
    run = Run(
        name="a.csv", time=STEP * np.arange(count),
        controls={f"servo{j + 1}": wave[:, j] for j in range(3)},
        sensors={f"encoder{j + 1}": 1e-9 * np.arange(count) for j in range(3)},
    )  # fmt: skip
    trial, floors = align_run(run, machine, ENCODERS, step=STEP), np.full(3, 2e-5)
    plain = ResidualModel(machine, [trial], ENCODERS, floors, threads=1)
    shown = plain.predict([Hypothesis().with_effects(pairs)])[0][0]
    trial.measured[:] = shown + np.random.default_rng(2).normal(0, floors, shown.shape)
    comparison = ResidualModel(machine, [trial], ENCODERS, floors, threads=1)
    fitted = stated(comparison, [e for e, _ in pairs], [values for _, values in pairs])
    return identifiability(comparison, fitted, candidates(machine, kinds))


def swings(seconds: float, size: float = 0.6, rate: float = 5.0) -> Array:
    time = STEP * np.arange(round(seconds / STEP))
    turns = np.sin(np.outer(time, rate * np.array([1.0, 1.4, 1.9])))
    return np.asarray(size * np.minimum(time, 1.0)[:, None] * turns)


def test_a_joint_that_turns_round_shows_its_friction_and_one_that_stands_does_not() -> None:
    wave = swings(3.0)
    wave[:, 2] = 0.0
    found = seen(wave, ["quadratic_drag", "joint_compliance"])
    assert ("quadratic_drag", "joint1") not in {(e.kind, e.where) for e in found.unidentifiable}
    slow = seen(swings(3.0, 0.002, 0.7), ["quadratic_drag", "viscous_friction"])
    drag = [each for each in slow.unidentifiable if each.kind == "quadratic_drag"]
    assert {each.where for each in drag} >= {"joint2", "joint3"}
    assert all(each.z < 5 and (each.additional_s is None or each.additional_s > 0) for each in drag)
    words = [w for w in identifiability_notes(slow) if "quadratic_drag" in w]
    assert len(words) == 1 and how_to_see("quadratic_drag") in words[0]


def test_effects_that_do_the_same_are_alike_and_more_of_the_same_is_no_help() -> None:
    """In a vertical plane a tilted base and a first encoder off its zero are the same."""
    spec = mujoco.MjSpec.from_string(PLANAR)
    spec.joint("joint1").stiffness = np.zeros(3)  # a spring feels the joint itself turn
    machine = NominalModel(spec, step=STEP, integrator=RK4)
    tilt = CATALOGUE["base_tilt"](machine, "base"), np.array([0.05])
    kinds = ["base_tilt", "encoder_offset", "coulomb_friction"]
    found = seen(swings(3.0), kinds, tilt, machine=machine)
    (pair,) = [p for p in found.confusable if p.kind == "base_tilt"]
    assert (pair.other_kind, pair.other_where) == ("encoder_offset", "joint1")
    assert pair.z < 5 and pair.additional_s is None
    (words,) = [w for w in identifiability_notes(found) if "do not tell" in w]
    assert "spirit level" in words


def test_a_longer_recording_shows_more_and_nothing_of_what_nothing_reads() -> None:
    kinds = ["quadratic_drag", "viscous_friction", "rotor_inertia", "actuator_lag", "sensor_bias"]
    wave = swings(2.0, 0.05, 2.0)
    once, often = (seen(np.tile(wave, (times, 1)), kinds) for times in (1, 8))
    assert len(often.unidentifiable) <= len(once.unidentifiable)
    left = {(e.kind, e.where) for e in often.unidentifiable}
    assert once.unidentifiable
    for each in once.unidentifiable:
        assert each.where not in ("shake", "rate3")
        if each.additional_s is not None and each.additional_s < 5:
            assert (each.kind, each.where) not in left
        if each.additional_s is None:
            assert (each.kind, each.where) in left


CHANNELS = (Channel("sensor.q"), Channel("sensor.acc", 0))
RATE, COUNT = 500.0, 5000
TIME = np.arange(COUNT) / RATE
ANGLE = 0.5 * np.sin(2 * np.pi * 0.37 * TIME) + 0.2 * np.sin(2 * np.pi * 1.31 * TIME + 1)
SPEED = np.gradient(ANGLE, TIME)


def trial_of(**given: object) -> Trial:
    whole = dict(
        name="run-01.csv", form="forward", time=TIME, measured=np.zeros((COUNT, 2)), step=1 / RATE,
        steps=COUNT, controls=np.zeros((COUNT, 1)), position=np.zeros(1), speed=np.zeros(1),
        resting=True,
    )  # fmt: skip
    return Trial(**(whole | given))  # type: ignore[arg-type]


def rows_of(runs: int = 1) -> Rows:
    trial, sample, channel = np.meshgrid(np.arange(runs), np.arange(COUNT), [0, 1], indexing="ij")
    sample = sample.ravel()
    block = (sample / RATE // 0.5).astype(int) + 100 * trial.ravel()
    no = np.zeros(sample.size, dtype=bool)
    return Rows(
        trial=trial.ravel(), channel=channel.ravel(), sample=sample, index=sample, block=block,
        random_excitation=no, is_feature=no, inverse=no,
    )  # fmt: skip


def motion() -> JointMotion:
    one = ANGLE[:, None]
    return JointMotion(
        joints=("turn",), units=("N·m",), time=TIME, position=one, speed=SPEED[:, None],
        acceleration=np.gradient(SPEED, TIME)[:, None], load=3 * np.sin(one),
        residual_torque=np.full_like(one, np.nan), residual_noise=np.array([np.nan]),
    )  # fmt: skip


def residual(on_q: Array) -> Array:
    noise = np.random.default_rng(1).normal(0, 1, (COUNT, 2))
    noise[:, 0] += on_q
    return noise.ravel()


def located(on_q: Array) -> Location:
    return locate(residual(on_q), rows_of(), [trial_of()], CHANNELS, [motion()])


def whitened(on_q: Array) -> tuple[ResidualTest, ...]:
    return residual_tests(residual(on_q), rows_of(), [trial_of()], CHANNELS, [motion()])


def test_noise_is_white_at_its_floor_at_every_frequency_and_goes_with_nothing() -> None:
    location, names = located(np.zeros(COUNT)), ["sensor.q", "sensor.acc.x"]
    assert [gap.channel for gap in location.channels] == names
    for gap in location.channels:
        assert gap.rms == pytest.approx(1, abs=0.05)
        assert strongest(gap.dependences) is None and main_band(gap) is None
        wide = [band for band in gap.bands if band.high > 3]
        assert all(0.8 < band.rms < 1.2 for band in wide)
        assert sum(band.share for band in gap.bands) == pytest.approx(1)
    assert location_notes(location) == []
    tests = whitened(np.zeros(COUNT))
    assert [t.channel for t in tests] == names
    assert all(t.white and not t.dependences and t.trend_z < 3.5 for t in tests)
    assert tests[0].correlation_time == pytest.approx(1 / RATE, rel=0.3)


@pytest.mark.parametrize(
    ("on_q", "quantity"),
    [
        (3 * np.sign(SPEED), "direction"),
        (3 * SPEED, "velocity"),
        (8 * np.cos(9 * ANGLE), "position"),
        (0.3 * np.gradient(SPEED, TIME), "acceleration"),
    ],
)
def test_a_residual_is_told_by_what_it_goes_with(on_q: Array, quantity: str) -> None:
    found = strongest(located(on_q).channels[0].dependences)
    assert found is not None and found.regressor == quantity


def test_a_resonance_a_constant_and_a_drift_are_told() -> None:
    location = located(6 * np.sin(2 * np.pi * 47 * TIME))
    band = main_band(location.channels[0])
    assert band is not None and (band.low, band.high) == (30.0, 100.0)
    (words,) = location_notes(location)
    assert words.startswith("sensor.q has a residual of up to 4.")
    assert "between 30 and 100 Hz" in words
    assert "almost constant" in location_notes(located(np.full(COUNT, 9.0)))[0]
    drift = whitened(2 * TIME / TIME[-1])
    assert drift[0].trend == pytest.approx(2, abs=0.2) and drift[0].trend_z > 6
    assert drift[1].trend_z < 4
    rest = whitened(2 * SPEED)[0]
    assert not rest.white and rest.correlation_time > 0.05
    assert "velocity" in {d.regressor for d in rest.dependences}


BOB = """<mujoco><option timestep="0.001"/><worldbody><body><joint name="pivot" axis="0 1 0"/>
<inertial pos="0 0 -.3" mass=".1" diaginertia="1e-5 1e-5 1e-5"/></body></worldbody>
<sensor><jointpos name="q" joint="pivot"/></sensor></mujoco>"""
INERTIA, WEIGHT = 0.1 * 0.3**2 + 1e-5, 0.1 * 9.81 * 0.3


def swing(rate: float, bearing: float = 0.004, drag: float = 0.002) -> tuple[Array, Array, float]:
    """Times, angles and the root mean square of the missing torque, by an own integrator.

    Dry friction [N·m] and drag [N·m·s²/rad²] slow the bob down.
    """
    parts = max(1, int(2000 / rate))
    step = 1 / rate / parts
    angle, speed, angles, torques = 1.2, 0.0, [], []
    for _ in range(int(15 * rate)):
        angles.append(angle)
        torques.append(bearing * np.tanh(speed / 0.01) + drag * speed * abs(speed))
        for _ in range(parts):
            friction = bearing * np.tanh(speed / 0.01) + drag * speed * abs(speed)
            speed -= step * (WEIGHT * np.sin(angle) + friction) / INERTIA
            angle += step * speed
    rms = float(np.sqrt(np.mean(np.square(torques))))
    return np.arange(len(angles)) / rate, np.array(angles), rms


def missing(time: Array, angle: Array) -> Location:
    """Location of the missing torque of the one joint."""
    run = Run(name="a.csv", time=time, sensors={"q": angle})
    machine, channels = NominalModel(mujoco.MjSpec.from_string(BOB)), channels_of([run])
    trial = align_run(run, machine, channels, step=0.001)
    found = joint_motion(machine, trial, channels, np.array([channel_floor(angle)]))
    return locate(np.zeros(0), rows_of(0), [trial], channels, [found])


ERRORS = {
    "loud noise": lambda q, rng: q + rng.normal(0, 5e-3, len(q)),
    "heavy tails": lambda q, rng: q + 2e-3 * rng.standard_t(2, len(q)),
    "quantised": lambda q, rng: np.round(q / (2 * np.pi / 4096)) * (2 * np.pi / 4096),
    "glitches": lambda q, rng: q + np.where(rng.random(len(q)) < 0.01, 0.3, 0.0),
    "held": lambda q, rng: np.repeat(q[::2], 2)[: len(q)] + rng.normal(0, 1e-4, len(q)),
    "slow to read": lambda q, rng: np.interp(np.arange(len(q)), np.arange(len(q))[::4], q[::4]),
}


@pytest.mark.parametrize("rate", [60.0, 500.0])
def test_residual_torque_is_that_of_the_truth_whatever_the_readings(rate: float) -> None:
    time, angle, true = swing(rate)
    for error, wrong in ERRORS.items():
        if error in ("held", "slow to read") and rate < 100:
            continue  # the swing itself is not resolved
        (gap,) = missing(time, wrong(angle, np.random.default_rng(2))).joints
        assert gap.unit == "N·m"
        assert abs(gap.residual / true - 1) < 0.3, error
        assert gap.residual < 0.1 * WEIGHT, error


def test_dry_friction_shows_as_torque_that_goes_with_the_direction() -> None:
    rng = np.random.default_rng(0)
    time, angle, true = swing(500.0, drag=0.0)
    location = missing(time, angle + rng.normal(0, 2e-5, len(time)))
    (gap,) = location.joints
    found = strongest(gap.dependences)
    assert found is not None and found.regressor == "direction"
    assert gap.residual == pytest.approx(true, rel=0.1)
    words = location_notes(location)[0]
    assert "pivot has a residual torque of 0.00" in words and "N·m" in words
    time, angle, _ = swing(200.0, bearing=0.0, drag=0.0)
    (nothing,) = missing(time, angle + rng.normal(0, 2e-3, len(time))).joints
    assert nothing.residual < 0.02 * WEIGHT


FINE, LONG = 0.001, 2800
READ = (*ENCODERS, Channel("sensor.rate3"), *(Channel("sensor.shake", axis) for axis in range(3)))
FLOORS = np.array([1e-5, 1e-5, 1e-5, 1e-3, 0.02, 0.02, 0.02])
NOTHING = Hypothesis()


@pytest.fixture(scope="module")
def own() -> NominalModel:
    return NominalModel(mujoco.MjSpec.from_string(PLANAR), step=FINE, integrator=RK4)


def first_of(own: NominalModel, kind: str) -> Hypothesis:
    effect = candidates(own, [kind])[0]
    return Hypothesis(effects=(effect,), values=(np.array(effect.starts[0]),))


def measured(own: NominalModel, truth: Hypothesis, *, noise: float = 0.0) -> Trial:
    """A forward run from rest."""
    time = np.arange(LONG) * FINE
    wave = np.sin(np.outer(time, [2.1, 3.4, 5.2])) * np.minimum(time, 1.0)[:, None]
    trial = Trial(
        name="run-01.csv", form="forward", time=time, measured=np.zeros((LONG, len(READ))),
        step=FINE, steps=LONG, controls=0.4 * wave, position=np.zeros(3), speed=np.zeros(3),
        resting=True,
    )  # fmt: skip
    shown = Simulator(own, [trial], READ, threads=1).predict([truth])[0][0]
    rng = np.random.default_rng(4)
    shown = shown + noise * FLOORS * rng.normal(0, 1, shown.shape)
    return replace(trial, measured=shown, motion={f"joint{k}": shown[:, k - 1] for k in (1, 2, 3)})


def errors(own: NominalModel, trial: Trial, hypothesis: Hypothesis) -> tuple[HorizonError, ...]:
    return horizon_errors(
        own, [trial], READ, FLOORS, hypothesis, every=0.5, horizons=(0.1, 0.5, 2.0), threads=1
    )


@pytest.mark.parametrize(
    "kind", ["joint_compliance", "command_delay", "encoder_offset", "sensor_bias", "sensor_delay"]
)
def test_the_truth_restarted_from_exact_readings_stays_on_them(
    own: NominalModel, kind: str
) -> None:
    truth = first_of(own, kind)
    trial = measured(own, truth)
    right = errors(own, trial, truth)
    assert [e.horizon for e in right] == [0.1, 0.5, 2.0]
    assert [e.starts for e in right] == [6, 5, 2]
    assert all(e.rms < 0.05 for e in right)
    wrong = errors(own, trial, NOTHING)
    assert wrong[-1].rms > 3 * max(right[-1].rms, 0.1)


def test_with_noise_the_truth_is_at_the_floor_and_a_wrong_model_is_not(own: NominalModel) -> None:
    truth = first_of(own, "viscous_friction")
    trial = measured(own, truth, noise=1.0)
    right, wrong = errors(own, trial, truth), errors(own, trial, NOTHING)
    assert all(0.97 < e.rms < 1.1 for e in right)
    assert wrong[0].rms > 1.2 and wrong[-1].rms > wrong[0].rms
    assert set(right[0].by_channel) == {channel.name for channel in READ}
    assert max(wrong[-1].by_channel, key=lambda c: wrong[-1].by_channel[c]) == "sensor.encoder1"


def test_missing_samples_count_for_nothing_and_inverse_runs_have_no_open_loop(
    own: NominalModel,
) -> None:
    trial = measured(own, NOTHING, noise=1.0)
    assert errors(own, replace(trial, form="inverse"), NOTHING) == ()
    trial.measured[::3, 1] = np.nan
    trial.measured[:, 3] = np.nan
    found = errors(own, trial, NOTHING)
    assert all(0.95 < e.rms < 1.1 for e in found)
    assert "sensor.rate3" not in found[0].by_channel
