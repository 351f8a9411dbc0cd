"""The torque a motion needs, against the torque measured."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from loose_env.errors import InvalidData
from loose_env.gap.data.aligned_run import align_run, channels_of
from loose_env.gap.data.motion_band import motion_band
from loose_env.gap.data.smoothing import smooth_motion
from loose_env.gap.model.effects.catalogue import CATALOGUE, candidates
from loose_env.gap.model.hypothesis import Hypothesis
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.residuals.residual_model import ResidualModel
from loose_env.recording import Run
from tests.gap.cases.effect_arms import PLANAR, SHARED, SPATIAL
from tests.gap.cases.recorded_runs import compared, fitted, measurable, needed, torque_run, waves

NOTHING = Hypothesis()


def arm(xml: str) -> NominalModel:
    return NominalModel(measurable(mujoco.MjSpec.from_string(xml)))


def edited(machine: NominalModel, kind: str, where: str, values: list[float]) -> mujoco.MjModel:
    spec = machine.fresh()
    CATALOGUE[kind](machine, where).edit(spec, np.array(values))
    return spec.compile()


def runs_of(
    machine: NominalModel, truth: mujoco.MjModel, count: int = 2, **given: object
) -> list[Run]:
    rng = np.random.default_rng(5)
    return [torque_run(machine, truth, rng, name=f"run-{k}", **given) for k in range(count)]  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("rate", "step", "speeds"),
    [(1000.0, 5e-5, 2e-3), (500.0, 2e-4, None), (125.0, 1e-4, None), (100.0, 1.5e-3, 0.01)],
)
def test_what_is_left_of_the_motions_noise_is_what_it_says(
    rate: float, step: float, speeds: float | None
) -> None:
    machine = arm(PLANAR)
    run = torque_run(
        machine, machine.model, np.random.default_rng(3),
        rate=rate, step=step, speeds=speeds, duration=12.0,
    )  # fmt: skip
    channels = channels_of([run])
    motion = smooth_motion(align_run(run, machine, channels, step=0.001), machine, channels)
    truth = waves(machine, run.time, np.random.default_rng(3))
    edge = int(rate)
    for k, found in enumerate((motion.position, motion.speed, motion.acceleration)):
        error = np.sqrt(np.mean((found - truth[k])[edge:-edge] ** 2, axis=0))
        assert np.all(error < 1.6 * motion.noise[k])
        assert np.all(error > 0.4 * motion.noise[k])
    assert 1.5 < motion.band.end < 20.0


def test_a_speed_sensor_that_lags_does_not_spoil_the_acceleration() -> None:
    machine = arm(PLANAR)
    run = torque_run(machine, machine.model, np.random.default_rng(3), step=2e-4, speeds=1e-4)
    truth = waves(machine, run.time, np.random.default_rng(3))[2]
    channels = channels_of([run])
    late = {k: np.roll(v, 15) if k.endswith("vel") else v for k, v in run.sensors.items()}
    alone = {k: v for k, v in run.sensors.items() if k.endswith("pos")}
    band = smooth_motion(align_run(run, machine, channels, step=0.002), machine, channels).band
    errors = []
    for sensors in (run.sensors, late, alone):
        other = Run(name="run", time=run.time, sensors=sensors, torques=run.torques)
        trial = align_run(other, machine, channels, step=0.002)
        motion = smooth_motion(trial, machine, channels, band=band)
        errors.append(float(np.std((motion.acceleration - truth)[300:-300])))
    good, lagging, encoders = errors
    assert good < 0.5 * encoders
    assert lagging < 1.5 * encoders


def test_the_band_ends_where_noise_begins() -> None:
    time = np.arange(8000) / 1000
    noise = np.random.default_rng(1).normal(0, 1e-4, len(time))
    fast = 2e-4 * np.sin(2 * np.pi * 30 * time)
    slow = np.sin(2 * np.pi * time)
    assert motion_band([slow + noise], 1000.0) < 12
    assert 29 < motion_band([slow + fast + noise], 1000.0) < 33


@pytest.mark.parametrize("xml", [PLANAR, SPATIAL])
@pytest.mark.parametrize("rate", [100.0, 1000.0])
def test_nothing_is_left_of_the_true_model_but_noise(xml: str, rate: float) -> None:
    machine = arm(xml)
    comparison = compared(machine, runs_of(machine, machine.model, rate=rate))
    residual = comparison.residuals([NOTHING])[0]
    for channel in np.unique(comparison.rows.channel):
        own = residual[comparison.rows.channel == channel]
        assert len(own) > 30
        assert 0.6 < np.sqrt(np.mean(own**2)) < 1.35


def test_gaps_and_uneven_times_are_bridged() -> None:
    machine = arm(PLANAR)
    run = runs_of(machine, machine.model, 1)[0]
    rng = np.random.default_rng(0)
    time = run.time + rng.uniform(-0.2e-3, 0.2e-3, len(run.time))
    position, speed, acceleration = waves(machine, time, np.random.default_rng(5))
    torque = needed(machine.model, position, speed, acceleration)
    missing = rng.random(len(time)) < 0.05
    sensors = {
        f"{joint}_pos": np.where(missing, np.nan, position[:, j] + rng.normal(0, 1e-4, len(time)))
        for j, joint in enumerate(machine.joints)
    }
    torques = {
        joint: torque[:, j] + rng.normal(0, 0.05, len(time))
        for j, joint in enumerate(machine.joints)
    }
    comparison = compared(machine, [Run(name="a", time=time, sensors=sensors, torques=torques)])
    residual = comparison.residuals([NOTHING])[0]
    assert 0.6 < np.sqrt(np.mean(residual**2)) < 1.4


@pytest.mark.parametrize(
    ("xml", "kind", "where", "values", "wrong"),
    [
        (PLANAR, "viscous_friction", "joint2", [1.5], ("rotor_inertia", "joint2")),
        (PLANAR, "payload", "tool", [0.5], ("viscous_friction", "joint1")),
        (PLANAR, "encoder_offset", "joint2", [0.05], ("viscous_friction", "joint2")),
        (PLANAR, "joint_spring", "joint3", [4.0, 0.3], ("coulomb_friction", "joint3")),
        (SPATIAL, "rotor_inertia", "reach", [3.0], ("viscous_friction", "reach")),
        (SPATIAL, "quadratic_drag", "lift", [2.0], ("coulomb_friction", "turn")),
    ],
)
def test_the_true_effect_is_found_and_a_wrong_one_is_not(
    xml: str, kind: str, where: str, values: list[float], wrong: tuple[str, str]
) -> None:
    machine = arm(xml)
    effect = CATALOGUE[kind](machine, where)
    values = values[: len(effect.parameters)] + list(effect.starts[0][len(values) :])
    comparison = compared(machine, runs_of(machine, edited(machine, kind, where, values)))
    right, found = fitted(comparison, [effect])
    false, _ = fitted(comparison, [CATALOGUE[wrong[0]](machine, wrong[1])])
    assert right.rms < 1.35  # the noise is that of the nominal model, whose inertias are smaller
    assert false.rms > 1.5 * right.rms
    assert abs(found[0][0] / values[0] - 1) < 0.1


def test_dry_friction_is_found_with_its_steps() -> None:
    machine = arm(PLANAR)

    def friction(speed: np.ndarray) -> np.ndarray:
        torque = np.zeros_like(speed)
        torque[:, 1] = 0.9 * np.tanh(speed[:, 1] / 0.004)
        return torque

    comparison = compared(machine, runs_of(machine, machine.model, friction=friction))
    before, _ = fitted(comparison, [])
    after, found = fitted(comparison, [CATALOGUE["coulomb_friction"](machine, "joint2")])
    other, _ = fitted(comparison, [CATALOGUE["viscous_friction"](machine, "joint2")])
    assert before.rms > 3
    assert after.rms < 1.25
    assert other.rms > 1.5 * after.rms
    assert abs(found[0][0] - 0.9) < 0.05


def test_drives_that_inverse_dynamics_leave_out_count() -> None:
    machine = arm(PLANAR)
    comparison = compared(machine, runs_of(machine, machine.model, 1))
    effect = CATALOGUE["torque_ripple"](machine, "joint1")
    values = np.array([2.0, 3.0, 0.4])
    with_it = Hypothesis(effects=(effect,), values=(values,))
    rippled, plain = comparison.predict([with_it, NOTHING])
    channel = [c.name for c in comparison.channels].index("torque.joint1")
    change = (rippled[0] - plain[0])[:, channel]
    angle = comparison.trials[0].motion["joint1"]
    kept = np.isfinite(change)
    kept[:500] = kept[-500:] = False
    assert np.allclose(change[kept], -2.0 * np.sin(3.0 * angle + 0.4)[kept], atol=0.05)


def test_reversals_are_left_out_for_their_joint_alone() -> None:
    machine = arm(PLANAR)
    run = runs_of(machine, machine.model, 1, step=4e-3, speeds=None, duration=60.0)[0]
    sensors = {k: np.zeros(run.samples) if k == "joint3_pos" else v for k, v in run.sensors.items()}
    comparison = compared(
        machine, [Run(name="run", time=run.time, sensors=sensors, torques=run.torques)]
    )
    assert comparison.inverse is not None
    motion, left_out = comparison.inverse.motions[0], {}
    rows = comparison.rows
    for joint in range(3):
        channel = [c.name for c in comparison.channels].index(f"torque.joint{joint + 1}")
        samples = rows.sample[rows.channel == channel]
        left_out[joint] = np.setdiff1d(rows.sample, samples)
        slowest = np.abs(motion.speed[samples, joint]).min()
        assert slowest > 3 * motion.noise[1, joint] or joint == 2
        assert np.all(np.abs(motion.speed[left_out[joint], joint]) < 3 * motion.noise[1, joint])
    assert len(left_out[0]) and len(left_out[1])
    assert not len(np.intersect1d(left_out[0], left_out[1]))
    assert not len(left_out[2])  # it never moves: whatever holds it, it is compared


def test_a_drive_that_gives_more_shows_less() -> None:
    machine = arm(PLANAR)
    runs = []
    for run in runs_of(machine, machine.model):
        torques = {j: v / 1.3 if j == "joint1" else v for j, v in run.torques.items()}
        runs.append(Run(name=run.name, time=run.time, sensors=run.sensors, torques=torques))
    comparison = compared(machine, runs)
    after, found = fitted(comparison, [CATALOGUE["actuator_gain"](machine, "servo1")])
    assert after.rms < 1.25
    assert abs(found[0][0] - 1.3) < 0.03


def test_one_of_two_motors_at_a_joint_is_not_told_by_their_torque() -> None:
    second = '<motor name="second" joint="joint1" gear="40"/></actuator>'
    machine = arm(PLANAR.replace("</actuator>", second))
    comparison = compared(machine, runs_of(machine, machine.model, 1))
    effects = {e.where: e for e in candidates(machine, ["actuator_gain"]) if not e.variant}
    assert {name for name, e in effects.items() if comparison.shows(e)} == {"servo2", "servo3"}
    torque = np.ones(3)
    for name, factor in (("servo1", 1.0), ("second", 1.0), ("servo2", 0.5)):
        joint = machine.actuated_joint[name]
        assert np.allclose(effects[name].sensed_torque(joint, torque, np.array([2.0])), factor)


def test_a_late_encoder_is_found() -> None:
    machine = arm(PLANAR)
    runs = []
    for run in runs_of(machine, machine.model, speeds=None, rate=1000.0):
        late = {k: np.roll(v, 12) if k == "joint1_pos" else v for k, v in run.sensors.items()}
        cut = slice(20, None)
        runs.append(
            Run(
                name=run.name,
                time=run.time[cut],
                sensors={k: v[cut] for k, v in late.items()},
                torques={k: v[cut] for k, v in run.torques.items()},
            )
        )
    comparison = compared(machine, runs)
    before, _ = fitted(comparison, [])
    after, found = fitted(comparison, [CATALOGUE["sensor_delay"](machine, "joint1_pos")])
    assert before.rms > 1.5 * after.rms
    assert abs(found[0][0] - 0.012) < 0.002


def test_which_effects_an_inverse_comparison_shows() -> None:
    machine = arm(PLANAR)
    comparison = compared(machine, runs_of(machine, machine.model, 1))
    shown = {f"{e.kind}@{e.where}" for e in candidates(machine) if comparison.shows(e)}
    assert shown >= {
        "payload@tool", "coulomb_friction@joint2", "joint_compliance@joint1",
        "encoder_offset@joint2", "actuator_gain@servo1", "sensor_delay@joint1_pos",
    }  # fmt: skip
    assert not shown & {
        "command_delay@all", "actuator_lag@servo1", "sensor_gain@shake",
        "sensor_misalignment@shake", "sensor_bias@joint1_pos",
    }  # fmt: skip


def test_a_joint_named_like_its_motor_keeps_its_effects() -> None:
    machine = arm(SPATIAL)
    assert set(machine.actuators) <= set(machine.joints)
    comparison = compared(machine, runs_of(machine, machine.model, 1))
    shown = {repr(e) for e in candidates(machine) if comparison.shows(e)}
    assert shown >= {
        "viscous_friction@lift", "joint_spring@turn", "rotor_inertia@reach", "encoder_offset@roll",
        "actuator_gain@roll",
    }  # fmt: skip
    assert not shown & {"actuator_lag@lift", "command_delay@lift", "actuator_gain@lift (command)"}


def test_a_model_led_along_a_motion_needs_what_inverse_dynamics_say() -> None:
    machine = arm(SPATIAL)
    comparison = compared(machine, runs_of(machine, machine.model, 1))
    inverse = comparison.inverse
    assert inverse is not None
    motion = inverse.motions[0]
    led = motion.band.smooth(inverse._drive.torque(NOTHING, motion))[motion.chosen]
    rigid = inverse.rigid(NOTHING.model(machine, 0.001), [motion])[0]
    assert np.all(np.std((led - rigid)[5:-5], axis=0) < 0.01 * np.std(rigid, axis=0))


def test_a_compliant_drive_is_found_from_its_motor_side() -> None:
    machine = arm(PLANAR)
    effect = CATALOGUE["joint_compliance"](machine, "joint2")
    spec = machine.fresh()
    effect.edit(spec, np.array([400.0, 0.1]))
    model = spec.compile()
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER  # the force it shows is what acts
    rng = np.random.default_rng(2)
    data = mujoco.MjData(model)
    names = [model.joint(j).name for j in range(model.njnt)]
    measured = [names.index(j) for j in machine.joints]
    time = np.arange(8000) * 0.001
    goals = waves(machine, time, rng, 0.3)[0]
    goals = (goals - goals[0]) * np.clip((time[:, None] - 1.5) / 1.0, 0, 1) ** 2
    rows = np.zeros((len(time), 6))
    for k, goal in enumerate(goals):
        data.ctrl[:] = goal
        mujoco.mj_forward(model, data)
        rows[k] = [*data.qpos[measured], *data.actuator_force]
        mujoco.mj_step(model, data)
    rows = rows[1000:]
    sensors = {
        f"{j}_pos": rows[:, k] + rng.normal(0, 2e-5, len(rows))
        for k, j in enumerate(machine.joints)
    }
    torques = {
        j: rows[:, 3 + k] + rng.normal(0, 0.2, len(rows)) for k, j in enumerate(machine.joints)
    }
    run = Run(name="a", time=time[1000:], sensors=sensors, torques=torques)
    comparison = compared(machine, [run], step=0.001)
    true = Hypothesis(effects=(effect,), values=(np.array([400.0, 0.1]),))
    stiff = Hypothesis(effects=(effect,), values=(np.array([1600.0, 0.1]),))
    right, wrong, rigid = np.sqrt(
        np.mean(comparison.residuals([true, stiff, NOTHING]) ** 2, axis=1)
    )
    assert right < 1.5
    assert wrong > 1.3 * right
    assert rigid > 1.3 * right


def test_a_six_axis_arm_with_gravity_and_real_friction() -> None:
    file = SHARED / "ur5e_bare.xml"
    if not file.is_file():
        pytest.skip("the published arms are not beside the repository")
    machine = NominalModel(measurable(mujoco.MjSpec.from_file(str(file))))
    truth = machine.fresh()
    for joint in truth.joints:
        joint.damping = np.array([4.0, 0, 0])
    rates, loads = np.array([6.0, 6, 5, 2, 2, 2]), np.array([8.0, 9, 6, 2, 2, 2])

    def friction(speed: np.ndarray) -> np.ndarray:
        return (rates - 4.0) * speed + loads * np.tanh(speed / 0.01)

    for rate in (125.0, 500.0):
        comparison = compared(
            machine, runs_of(machine, truth.compile(), speeds=None, friction=friction, rate=rate,
                             duration=20.0, noise=0.03),
        )  # fmt: skip
        before, _ = fitted(comparison, [])
        effects = [
            CATALOGUE[kind](machine, joint)
            for kind in ("viscous_friction", "coulomb_friction")
            for joint in machine.joints
        ]
        after, found = fitted(comparison, effects)
        assert before.rms > 10
        assert after.rms < 1.4
        damping = np.array([v[0] for v in found[:6]]) + machine.model.dof_damping
        print(
            f"{rate:g} Hz: {before.rms:.1f} -> {after.rms:.2f}", np.concatenate(found[6:]).round(2)
        )
        assert np.allclose(np.concatenate(found[6:]), loads, rtol=0.1)
        assert np.all(damping < 2 * rates + 2)


def test_a_run_too_short_to_smooth_is_refused() -> None:
    machine = arm(PLANAR)
    run = torque_run(
        machine, machine.model, np.random.default_rng(0), duration=0.07, rate=200.0, speeds=None
    )
    with pytest.raises(InvalidData, match="too short"):
        compared(machine, [run])


def test_a_comparison_is_the_same_twice() -> None:
    machine = arm(PLANAR)
    runs = runs_of(machine, machine.model, 1)
    first, second = (compared(machine, runs).residuals([NOTHING]) for _ in range(2))
    assert isinstance(compared(machine, runs), ResidualModel)
    assert np.array_equal(first, second)


@pytest.mark.parametrize("seconds", [1.0, 3.0, 10.0])
def test_the_noise_of_a_short_run_is_no_motion(seconds):
    """Spectra of few segments scatter: no line of noise may pass for a fast motion."""
    rng = np.random.default_rng(5)
    time = np.arange(round(1000 * seconds)) / 1000
    slow = np.sin(2 * np.pi * 2.0 * time)
    bands = [motion_band([slow + rng.normal(0, 1e-2, len(time))], 1000.0) for _ in range(100)]
    assert max(bands) < 6.0


def test_an_effect_that_is_gone_leaves_nothing_to_one_in_its_place() -> None:
    machine = arm(PLANAR)
    runs = runs_of(machine, machine.model, count=1)
    model = compared(machine, runs)
    sensors = [name for name in runs[0].sensors if name.endswith("pos")][:2]

    def torque(sensor: str) -> object:
        effect = CATALOGUE["sensor_gain"](machine, sensor)  # a new one each time, kept by nobody
        own = Hypothesis(effects=(effect,), values=(np.array([1.1]),))
        return model.residuals([own])[0]

    first, other = (np.array(torque(sensor)) for sensor in sensors)
    again = [np.array(torque(sensor)) for sensor in sensors]
    assert not np.allclose(first, other)
    assert np.array_equal(first, again[0]) and np.array_equal(other, again[1])
