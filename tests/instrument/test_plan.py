"""The next step of a session: actuators, limits, pose, joint, signal, and the written files."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import yaml

from loose_env.cli.main import main
from loose_env.errors import InvalidData, InvalidSetting, UnknownName
from loose_env.instrument import (
    Diagnosis,
    Fault,
    InstrumentedArm,
    ModelSettings,
    MotionSettings,
    NextSettings,
    Plan,
    PlanFiles,
    PlanSettings,
    RecordSeen,
    ToolPlan,
    next_for,
    plan,
    plan_tool,
    read_arm,
    read_recorded_arm,
    session_beside,
    write_plan,
)
from loose_env.instrument.planning.files import signal_files
from loose_env.recording import read_parquet, read_recording, write_csv
from loose_env.report import plan_commands
from tests.instrument.arms import MOTORS, SERVOED, URDF, doubled, held, play, written

FEW = NextSettings(poses=2, seconds=1.0)
ROS = MotionSettings(signal_format=("ros2",), command_rate_hz=250.0)
HAMMER = ModelSettings(excitation="hammer")
POSE = PlanSettings(joint="lift", pose_deg=(0.0, -20.0, 60.0))


@pytest.fixture(scope="module")
def servoed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("servoed"), SERVOED)


@pytest.fixture(scope="module")
def motors(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("motors"), MOTORS)


@pytest.fixture(scope="module")
def first(servoed: Path) -> Plan:
    return plan(servoed, choice=FEW, own=PlanSettings(reference=True, repeat=2))


@pytest.fixture(scope="module")
def struck(servoed: Path) -> ToolPlan:
    return plan_tool(servoed, arm=HAMMER, choice=replace(FEW, poses=4))


def read(path: Path) -> Any:
    return json.loads(path.read_text("utf-8"))


def files(folder: Path, made: Plan) -> PlanFiles:
    return PlanFiles(folder, made.arm.recording_model.xml)


def known(
    arm: InstrumentedArm, pose: dict[str, float], joints: tuple[str, ...] = (), **shares: float
) -> Diagnosis:
    """A diagnosis that holds links for probably loose, after one record in a pose."""
    names = arm.hypotheses
    posterior = dict.fromkeys(names, (1 - sum(shares.values())) / (len(names) - len(shares)))
    posterior |= {f"structural_looseness@{link}": p for link, p in shares.items()}
    best = max(posterior, key=lambda name: posterior[name])
    kind, _, where = best.partition("@")
    record = RecordSeen(
        file="run-01.csv", pose=pose, excited=joints, condition="suspect", probabilities=posterior,
        direction_tool=(0.6, 0.0, 0.8), half_angle_deg=12.0,
    )  # fmt: skip
    fault = Fault(kind=kind, where=where or None)  # type: ignore[arg-type]
    return Diagnosis(
        fault=fault, probability=posterior[best], posterior=posterior, records=(record,)
    )


# ------------------------------------------------------------------------- the arm of a model

MOTOR = '<motor name="lift_motor" joint="lift" gear="30"/>'
SECOND = '<position name="lift_second" joint="lift" kp="300" kv="10"/>'
TACHO = '<velocity name="lift_speed" joint="lift" kv="7"/>'
STIFF = '<general name="lift_spring" joint="lift" gainprm="0" biastype="affine" biasprm="3 -50 0"/>'


def test_all_actuators_of_a_joint_hold_together_and_none_is_sent_to_zero(tmp_path: Path) -> None:
    path = written(tmp_path, doubled(MOTOR, SECOND, TACHO, STIFF))
    made = plan(path, choice=FEW, own=POSE)
    model = made.arm.recording_model.model
    signal = made.signals[0]
    still = round(0.85 * (signal.steady_s[0] - 0.25) * signal.rate_hz)  # before the noise
    commands = {name: float(u[still]) for name, u in signal.commands.items()}
    data = held(model, made.pose, commands)
    assert data.qacc == pytest.approx(0.0, abs=1e-6)
    drive = made.arm.drives[1]
    assert drive is not None and drive.servo  # a servo holds by itself, a motor does not
    for name in {"lift_motor", "lift_second", "lift_speed", "lift_servo"} - {drive.actuator}:
        if name in commands:
            force = float(data.actuator_force[model.actuator(name).id])
            assert force == pytest.approx(0.0, abs=1e-9)
    other = "lift_servo" if drive.actuator == "lift_second" else "lift_second"
    assert commands[other] == pytest.approx(made.pose[1])
    assert any("lift_motor" in note and "no torque" in note for note in made.warnings)
    # Plan and diagnosis reckon with the same springs.
    recorded = read_recorded_arm(written(tmp_path, made.arm.recording_model.xml, "model.xml"))
    centring = made.arm.nominal.centring
    assert centring.stiffness[1] == recorded.actuators.stiffness[1] == 900 + 300 + 50
    assert centring.damping[1] == recorded.actuators.damping[1] == 30 + 10 + 7


def stated(folder: Path, text: str, name: str = "arm.xml", **given: Any) -> Plan:
    return plan(written(folder, text, name), choice=FEW, motion=MotionSettings(**given))


CONTROL = """<ros2_control name="x" type="system"><joint name="j2">
<command_interface name="velocity"><param name="min">-1.1</param><param name="max">1.2</param>
</command_interface></joint></ros2_control></robot>"""
OWN = '<custom><numeric name="max_jerk_rad_s3" data="700 800"/></custom></mujoco>'
MOTOR2 = '<motor name="m2" joint="elbow" gear="20" ctrlrange="-1 1"/>'
VELOCITY = '<velocity name="m2" joint="elbow" kv="5" gear="2" ctrlrange="-3 3"/>'
JERKY = 'effort="80" velocity="1.5" jerk="900"'


@pytest.mark.parametrize(
    ("name", "text", "given", "quantity", "values", "source"),
    [
        ("a.urdf", URDF.replace('effort="80" velocity="2"', JERKY), {}, "speed", [1.5, 2.0],
         '<limit velocity="1.5"> of a.urdf'),
        ("a.urdf", URDF.replace('effort="80" velocity="2"', JERKY), {}, "jerk", [900.0, np.inf],
         ""),
        ("a.urdf", URDF.replace("</robot>", CONTROL), {}, "speed", [2.0, 1.1],
         "ros2_control velocity command_interface"),  # the tightest of several
        ("a.xml", MOTORS.replace("</mujoco>", OWN), {}, "jerk", [700.0, 800.0],
         "<numeric name='max_jerk_rad_s3'> of a.xml"),
        ("a.xml", MOTORS.replace(MOTOR2, VELOCITY), {}, "speed", [3.14, 1.5], "'m2'"),
        ("a.urdf", URDF, {"max_speed_rad_s": (4.0, 5.0)}, "speed", [4.0, 5.0],
         "--max-speed-rad-s"),  # what is given takes the place of what is stated
        ("a.xml", SERVOED, {}, "speed", [3.14] * 3, "assumed"),
        ("a.xml", SERVOED, {}, "acceleration", [np.inf] * 3, ""),
    ],
)  # fmt: skip
def test_limits_of_motion_are_given_or_stated_or_assumed(
    tmp_path: Path, name: str, text: str, given: dict[str, Any], quantity: Any,
    values: list[float], source: str,
) -> None:  # fmt: skip
    limits = stated(tmp_path, text, name, **given).limits
    assert limits.values[quantity].tolist() == values
    assert any(source in each for each in limits.sources[quantity])


def test_a_stated_limit_that_is_no_positive_number_is_refused(tmp_path: Path) -> None:
    wrong = URDF.replace('velocity="2"', 'velocity="-2"', 1)
    with pytest.raises(InvalidData, match=r"joint 'j1' has a speed limit .*--max-speed-rad-s"):
        stated(tmp_path, wrong, "arm.urdf")


_SENSORS = '<sensor><accelerometer name="outer" site="tool"/></sensor></mujoco>'
_TOOL = '<site name="tool" pos=".35 .03 0"/>'
_TWIN = f'{_TOOL}<site name="beside" pos=".3 0 0"/>'
_INNER = '<site name="mid" pos=".2 0 .03"/><body name="fore"'


@pytest.mark.parametrize(
    ("old", "new", "tool", "sites"),
    [
        ('<body name="fore"', _INNER, "mid", ("mid",)),  # the model's own sits farther out
        (_TOOL, _TWIN, "beside", ("beside", "tool")),
    ],
)
def test_a_tool_that_was_named_stays_the_tool_of_the_recording(
    tmp_path: Path, old: str, new: str, tool: str, sites: tuple[str, ...]
) -> None:
    text = SERVOED.replace(old, new).replace("</mujoco>", _SENSORS)
    made = read_arm(written(tmp_path, text), ModelSettings(tool=tool)).recording_model
    machine = read_recorded_arm(written(tmp_path, made.xml, "recorded.xml"))
    assert made.site == tool and machine.sites[: len(sites)] == sites
    assert machine.joints == (("pan", "lift") if tool == "mid" else ("pan", "lift", "elbow"))
    at_tool = [r.sensor for r in machine.readings if r.kind == "acceleration" and r.at == 0]
    assert at_tool == ["tool_accelerometer"]


@pytest.mark.parametrize(
    "place",
    [
        '<site name="tool" pos=".3 .02 0" euler="0 90 0"/>',
        '<site name="tool" pos=".3 .02 0" zaxis="1 0 0"/>',
        '<frame pos=".3 0 0" euler="0 90 0"><site name="tool" pos="0 .02 0"/></frame>',
    ],
)
def test_a_load_sits_in_the_tool_frame_however_the_file_writes_it(
    tmp_path: Path, place: str
) -> None:
    settings = ModelSettings(payload_kg=2.0, payload_at_m=(0.0, 0.0, 0.2))
    found = read_arm(written(tmp_path, SERVOED.replace(_TOOL, place)), settings)
    model = found.recording_model.model
    assert model.body("payload").pos == pytest.approx(np.array([0.5, 0.02, 0.0]), abs=1e-9)


def test_a_payload_takes_torque_to_hold(servoed: Path) -> None:
    bare, loaded = (
        read_arm(servoed, ModelSettings(payload_kg=kg)).linear.at([0.0, 0.0, 0.0]).gravity_torque
        for kg in (0.0, 2.0)
    )
    assert np.abs((loaded - bare)[1]) == pytest.approx(2.0 * 9.81 * 0.75, rel=1e-6)


def test_a_urdf_without_actuators_or_meshes_gets_motors_and_its_flange(tmp_path: Path) -> None:
    made = plan(written(tmp_path, URDF, "plain.urdf"), choice=FEW)
    assert made.arm.report.tool == "flange"
    assert set(made.signals[0].commands) == {"j1_motor", "j2_motor"}
    assert any("torque motors are added" in warning for warning in made.warnings)


# ------------------------------------------------------------------------- signals


@pytest.mark.parametrize(
    "joint", ["elbow", *(pytest.param(j, marks=pytest.mark.slow) for j in ("pan", "lift"))]
)
def test_what_is_played_on_servos_does_what_the_plan_says(servoed: Path, joint: str) -> None:
    choice = replace(FEW, poses=8, seconds=1.2)
    made = plan(servoed, choice=choice, own=PlanSettings(joint=joint, hold_s=1.5))
    signal, did = made.signals[0], play(made, step=5e-5)
    assert did.tool_rms == pytest.approx(signal.tool_rms, rel=0.05)
    assert did.joint_rms == pytest.approx(signal.joint_rms, rel=0.05)
    allowed = choice.torque_share * np.array(made.arm.nominal.torque_limits)
    assert (signal.torque_peaks <= allowed * 1.001).all()
    assert (did.torque_peaks <= allowed * 1.03).all()
    assert did.travel == pytest.approx(signal.travel, rel=0.15, abs=2e-5)
    assert did.standing < 1e-3 * did.tool_rms  # it holds its pose before the noise begins
    assert did.held_at == pytest.approx(made.pose, abs=1e-5)
    on = (signal.time >= signal.steady_s[0]) & (signal.time < signal.steady_s[1])
    sensor = made.arm.recording_model.positions[made.arm.joints.index(joint)]
    speed = np.abs(np.diff(did.columns[f"sensor.{sensor}"][on])).max() * signal.rate_hz
    (peak,) = (p for p in signal.peaks if (p.joint, p.of, p.quantity) == (joint, "joint", "speed"))
    assert speed == pytest.approx(peak.value, rel=0.1)


def test_two_servos_on_a_joint_do_what_the_plan_says(tmp_path: Path) -> None:
    path = written(tmp_path, doubled(SECOND, TACHO))
    made = plan(path, choice=replace(FEW, poses=4, seconds=1.2), own=PlanSettings(joint="lift"))
    signal, did = made.signals[0], play(made, step=5e-5)
    assert did.tool_rms == pytest.approx(signal.tool_rms, rel=0.05)
    assert did.joint_rms == pytest.approx(signal.joint_rms, rel=0.05)


def test_motors_are_given_torque_that_holds_the_pose_too(motors: Path) -> None:
    made = plan(motors, choice=replace(FEW, poses=8), own=PlanSettings(joint="lift"))
    did = play(made, step=5e-5)
    assert did.tool_rms == pytest.approx(made.signals[0].tool_rms, rel=0.05)
    assert did.standing < 1e-3 * did.tool_rms
    hold = made.signals[0].commands["m2"]
    assert hold[0] != 0 and (hold == hold[0]).all()  # gravity
    assert np.abs(made.signals[0].commands["m1"]).max() <= FEW.torque_share


def test_the_noise_swells_and_stays_in_its_band(first: Plan) -> None:
    signal = first.signals[0]
    drive = first.arm.drives[first.arm.joints.index(signal.joint)]
    assert drive is not None
    command = signal.commands[drive.actuator]
    start, end = signal.steady_s
    assert start == pytest.approx(0.75)
    assert end - start == pytest.approx(FEW.seconds)
    assert (command[signal.time < 0.5] == command[0]).all()
    noise = command[(signal.time >= start) & (signal.time < end)] - command[0]
    power = np.abs(np.fft.rfft(noise)) ** 2
    frequency = np.fft.rfftfreq(len(noise), 1e-3)
    low, high = first.next.band_hz
    outside = (frequency < low - 1) | (frequency > high + 1)
    assert power[outside].sum() < 1e-6 * power.sum()
    steps = np.abs(np.diff(command))
    assert steps.max() < 1.5 * np.abs(noise).max()  # no jump at either end of the ramps


@pytest.mark.parametrize(
    "limits",
    [
        {"max_speed_rad_s": (0.5, 2.0, 1.0), "max_acceleration_rad_s2": (60.0,)},
        {"max_jerk_rad_s3": (2e4,)},
        {},  # an arm of 180 degrees a second
    ],
)
def test_the_command_of_a_servo_keeps_within_every_limit(
    servoed: Path, limits: dict[str, Any]
) -> None:
    made = plan(servoed, choice=replace(FEW, poses=4), motion=MotionSettings(**limits))
    signal = made.signals[0]
    j = made.arm.joints.index(signal.joint)
    drive = made.arm.drives[j]
    assert drive is not None
    joint = signal.commands[drive.actuator] * drive.gain / drive.stiffness
    for power, quantity in enumerate(("speed", "acceleration", "jerk"), start=1):
        found = float(np.abs(np.diff(joint, n=power)).max() * signal.rate_hz**power)
        assert found <= made.limits.limit(quantity, j) * (1 + 1e-6)  # type: ignore[arg-type]
    assert all(peak.within for signal in made.signals for peak in signal.peaks)
    assert signal.limited_by
    if not limits:
        assert max(p.value for p in signal.peaks if p.quantity == "speed") <= 3.14 + 1e-9
        assert max(one.deviations for one in made.expected.values()) > 4.0  # detectable still
        free = plan(servoed, choice=FEW, motion=MotionSettings(max_speed_rad_s=(1e6,)))
        assert max(p.value for p in free.signals[0].peaks if p.quantity == "speed") > 3.14


def test_a_torque_rate_limit_lowers_the_torque_of_motors(motors: Path) -> None:
    own = PlanSettings(joint="lift")
    free = plan(motors, choice=FEW, own=own).signals[0]
    rate = MotionSettings(max_torque_rate_nm_s=(100.0,))
    slow = plan(motors, choice=FEW, own=own, motion=rate).signals[0]
    torque = slow.commands["m1"] * 50.0
    assert np.abs(np.diff(torque)).max() * slow.rate_hz <= 100.0 * (1 + 1e-6)
    assert slow.torque_rms < free.torque_rms
    assert "torque rate" in slow.limited_by


def test_what_cannot_be_detected_within_the_limits_is_said(servoed: Path) -> None:
    slow = MotionSettings(max_acceleration_rad_s2=(0.2,))
    made = plan(servoed, choice=FEW, own=PlanSettings(hold_s=5.0), motion=slow)
    assert any("no fault is detectable in this run" in warning for warning in made.warnings)
    assert any("acceleration of the command" in warning for warning in made.warnings)


def test_band_and_rate_are_those_of_controller_and_recorder(servoed: Path) -> None:
    narrow = MotionSettings(command_bandwidth_hz=25.0, command_rate_hz=250.0)
    made = plan(servoed, choice=FEW, motion=narrow)
    low, high = made.next.band_hz
    assert 2.0 <= low < high <= 25.0
    assert made.signals[0].rate_hz == pytest.approx(250.0)
    assert made.next.rate_hz == FEW.rate_hz  # that of the recorder
    made = plan(servoed, choice=FEW, motion=MotionSettings(command_rate_hz=250.0))
    assert made.next.band_hz[1] <= 100.0
    made = plan(servoed, choice=replace(FEW, rate_hz=300.0))
    assert made.next.band_hz[1] <= 0.4 * 300.0
    assert np.diff(made.signals[0].time) == pytest.approx(1 / 300.0)


def test_positions_and_velocities_are_the_motion_that_the_torque_would_make(servoed: Path) -> None:
    where, fast = (
        plan(servoed, choice=FEW, own=POSE, motion=MotionSettings(commands=kind))
        for kind in ("position", "velocity")
    )
    signal = where.signals[0]
    assert list(signal.played) == ["position.pan", "position.lift", "position.elbow"]
    lift = signal.played["position.lift"]
    assert lift[0] == lift[-1] == pytest.approx(where.pose[1])
    on = (signal.time >= signal.steady_s[0]) & (signal.time < signal.steady_s[1])
    omega = 2j * np.pi * np.fft.rfftfreq(int(on.sum()), 1 / signal.rate_hz)
    acceleration = np.fft.irfft(omega**2 * np.fft.rfft(lift[on] - where.pose[1]), int(on.sum()))
    assert np.sqrt(np.mean(acceleration**2)) == pytest.approx(signal.joint_rms, rel=1e-6)
    assert (signal.played["position.pan"] == where.pose[0]).all()
    led = np.cumsum(fast.signals[0].played["velocity.lift"]) / fast.signals[0].rate_hz
    assert led[:-1] == pytest.approx((lift - lift[0])[1:], abs=1e-12)


def test_no_joint_is_told_what_its_actuator_does_not_take(tmp_path: Path) -> None:
    """A servo that gives way has to be told more than the pose, which its range may not hold."""
    narrow = SERVOED.replace('kp="900"', 'kp="200"').replace("-2.2 2.2", "-0.35 2.2")
    model, own = written(tmp_path, narrow), PlanSettings(joint="pan")
    with pytest.raises(InvalidData, match=r"lift_servo would have to be told .* from -0.35 to 2.2"):
        plan(model, choice=FEW, own=replace(own, pose_deg=(0.0, -20.0, 60.0)))
    told = plan(model, choice=FEW, own=own).signals[0].commands["lift_servo"]
    assert -0.35 <= told.min() <= told.max() <= 2.2


# ------------------------------------------------------------------------- choice


def test_the_same_seed_gives_the_same_plan(servoed: Path, first: Plan) -> None:
    again = plan(servoed, choice=FEW)
    assert again.next == first.next
    drive = first.signals[0].commands
    assert all((again.signals[0].commands[name] == u).all() for name, u in drive.items())
    other = plan(servoed, choice=replace(FEW, seed=1))
    assert any((other.signals[0].commands[name] != u).any() for name, u in drive.items())


def test_no_pose_touches_the_ground_or_leaves_the_ranges(servoed: Path) -> None:
    machine = read_arm(servoed)
    assert machine.collisions.touch([0.0, 1.2, 0.8])  # the tool through the floor
    for seed in range(4):
        chosen = next_for(machine, settings=replace(FEW, seed=seed, poses=4))
        pose = np.array([chosen.pose[name] for name in machine.joints])
        assert not machine.collisions.touch(pose)
        assert machine.nominal.within_ranges(pose).all()


def test_a_second_plan_moves_on_to_tell_two_links_apart(servoed: Path, first: Plan) -> None:
    choice = replace(FEW, poses=8, seconds=1.2)
    before = next_for(first.arm, settings=choice)
    so_far = known(first.arm, dict(before.pose), before.joints, post=0.45, fore=0.45)
    made = plan(servoed, so_far, choice=choice)
    assert made.next.pose != before.pose
    names = ("structural_looseness@post", "structural_looseness@fore")
    assert all(name in made.next.reason for name in names)
    one, other = (made.expected[name].direction_tool for name in names)
    assert one is not None and other is not None
    assert np.degrees(np.arccos(min(abs(float(np.dot(one, other))), 1.0))) > 30


def test_a_plan_takes_what_the_diagnosis_wants_next_but_not_through_the_floor(
    servoed: Path, first: Plan
) -> None:
    """The recording's model has no meshes, and knows of fewer collisions than the arm's own."""
    chosen = replace(FEW, seed=7)
    fast = MotionSettings(max_speed_rad_s=(1e3,))
    wanted = next_for(first.arm, settings=chosen, motion=fast)
    so_far = known(first.arm, dict(first.next.pose), first.next.joints, fore=0.5)
    so_far = replace(so_far, next=wanted)
    for choice in (None, chosen):
        made = plan(servoed, so_far, choice=choice, motion=fast)
        assert (made.next.pose, made.next.joints) == (wanted.pose, wanted.joints)
        assert made.next.seconds == made.settings["seconds"] == 1.0
        assert not any("asks for next" in warning for warning in made.warnings)
    low = {"pan": 0.0, "lift": 1.2, "elbow": 0.8}
    made = plan(servoed, replace(so_far, next=replace(first.next, pose=low)), choice=FEW)
    assert made.next.pose != low and not first.arm.collisions.touch(made.pose)
    assert any("its pose is not taken" in warning for warning in made.warnings)
    settled = plan(servoed, replace(so_far, settled=True), choice=FEW)
    assert any("settled" in w and "only confirm" in w for w in settled.warnings)
    assert not any("only confirm" in warning for warning in made.warnings)


def test_the_next_command_has_the_options_that_the_session_began_with(servoed: Path) -> None:
    made = plan(
        servoed,
        arm=ModelSettings(payload_kg=0.5, payload_at_m=(0.0, 0.0, 0.1), tool="tool"),
        choice=replace(FEW, most_tool=5.0),
        own=PlanSettings(joint="lift", hold_s=0.7),
    )
    command = plan_commands(made, "DIR")[-1]
    for words in ("--tool tool", "--payload-kg 0.5", "--payload-at-m 0 0 0.1", "--most-tool 5",
                  "--seconds 1", "--hold-s 0.7"):  # fmt: skip
        assert words in command
    assert "--joint" not in command and "--noise-ug" not in command


@pytest.mark.parametrize(
    ("given", "kind", "words"),
    [
        ({"own": PlanSettings(joint="knee")}, UnknownName, r"'knee'.*pan, lift, elbow"),
        ({"own": PlanSettings(pose_deg=(1.0, 2.0))}, InvalidSetting, r"each of pan, lift, elbow"),
        ({"own": PlanSettings(pose_deg=(0.0, 170.0, 0.0))}, InvalidSetting, r"lift at 170.*-120"),
        ({"choice": replace(FEW, rate_hz=60.0)}, InvalidSetting, r"60 Hz allows up to 24 Hz"),
        ({"motion": MotionSettings(max_speed_rad_s=(1.0, 2.0))}, InvalidSetting,
         r"max_speed_rad_s .* pan, lift, elbow; got 2"),
        ({"motion": MotionSettings(command_bandwidth_hz=3.0)}, InvalidSetting,
         r"followed up to 3 Hz.*--excitation hammer"),
    ],
)  # fmt: skip
def test_what_cannot_be_planned_is_refused(
    servoed: Path, given: dict[str, Any], kind: type[Exception], words: str
) -> None:
    with pytest.raises(kind, match=words):
        plan(servoed, **{"choice": FEW, **given})


def test_a_diagnosis_of_another_model_is_refused(motors: Path, first: Plan) -> None:
    so_far = known(first.arm, dict(first.next.pose), first.next.joints, fore=0.5)
    with pytest.raises(InvalidData, match=r"another model.*structural_looseness@post"):
        plan(motors, so_far, choice=FEW)


# ------------------------------------------------------------------------- a hammer, a shaker


def test_directions_are_of_several_axes_and_open_more_with_more_force(
    servoed: Path, struck: ToolPlan
) -> None:
    sensor = struck.arm.recording_model.model.sensor("tool_force")
    assert int(sensor.dim[0]) == 3 and int(sensor.type[0]) == int(mujoco.mjtSensor.mjSENS_USER)
    assert struck.columns[1:4] == tuple(f"sensor.tool_force.{axis}" for axis in "xyz")
    assert read_arm(servoed).tool_force is None  # without a hammer the model is as before
    assert len({run.name[1] for run in struck.runs}) == 2
    pose = tuple(np.degrees(struck.pose))
    weak, hard = (
        plan_tool(servoed, arm=HAMMER, choice=FEW, own=PlanSettings(force_n=f, pose_deg=pose))
        for f in (2.0, 200.0)
    )
    for link in struck.arm.links:
        low = max(run.opens[link] for run in weak.runs)
        high = max(run.opens[link] for run in hard.runs)
        assert low <= high <= 1.0
    assert any("strike harder" in warning for warning in weak.warnings)


def test_a_shaker_gets_a_force_in_the_band(servoed: Path) -> None:
    own = PlanSettings(force_n=12.0)
    made = plan_tool(servoed, arm=ModelSettings(excitation="shaker"), choice=FEW, own=own)
    assert made.signal is not None
    time, force = made.signal["time"], made.signal["force.tool"]
    steady = (time >= 0.25) & (time < 1.25)
    assert np.sqrt(np.mean(force[steady] ** 2)) == pytest.approx(12.0, rel=0.01)
    power = np.abs(np.fft.rfft(force[steady])) ** 2
    frequency = np.fft.rfftfreq(int(steady.sum()), time[1])
    low, high = made.band_hz
    outside = (frequency < low - 2) | (frequency > high + 2)
    assert power[outside].sum() < 1e-3 * power.sum()


def test_poses_that_were_struck_are_not_taken_again(servoed: Path, struck: ToolPlan) -> None:
    so_far = known(struck.arm, dict(struck.next_pose))
    later = plan_tool(servoed, so_far, arm=HAMMER, choice=replace(FEW, poses=4))
    assert np.abs(later.pose - struck.pose).max() > 0.2
    assert later.start_origin == "the pose of the last run"


@pytest.mark.parametrize("kind", ["hammer", "shaker"])
def test_the_command_writes_the_sheet_and_the_recording_of_a_tool(
    servoed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str
) -> None:
    out = tmp_path / "session"
    command = ["plan", str(servoed), "--out", str(out), "--excitation", kind, "--poses", "2"]
    assert main([*command, "--reference", "--force-n", "15"]) == 0
    said = capsys.readouterr().out
    assert f"{'strike' if kind == 'hammer' else 'shake'} the tool along" in said
    assert (out / "signal.csv").is_file() == (kind == "shaker")
    listed = read(out / "recording" / "recording.json")["runs"]
    assert [run["file"] for run in listed] == [
        "run-01.csv", "run-02.csv", "repeat-01.csv", "reference-01.csv", "reference-02.csv",
    ]  # fmt: skip
    assert all("excited" not in run for run in listed)
    whole = read(out / "plan.json")
    assert (whole["excitation"], whole["force_sensor"]) == (kind, "tool_force")
    assert "sensor.tool_force.x" in (out / "plan.html").read_text("utf-8")
    assert main(command) == 0  # goes on with the settings of before
    assert "--force-n 15" in capsys.readouterr().err


# ------------------------------------------------------------------------- files


def test_both_tables_hold_the_same_signal_and_json_says_all(first: Plan, tmp_path: Path) -> None:
    write_plan(files(tmp_path, first), first)
    text = np.genfromtxt(tmp_path / "signal.csv", delimiter=",", names=True)
    table = read_parquet(tmp_path / "signal.parquet", "signal.parquet", lambda header: None)
    for name, values in table.columns.items():
        assert (text[name.replace(".", "")] == values).all()
    assert list(table.columns) == ["time", "ctrl.pan_servo", "ctrl.lift_servo", "ctrl.elbow_servo"]
    whole = read(tmp_path / "plan.json")
    assert (whole["format"], whole["seed"]) == ("loose-plan/1", 0)
    assert set(whole["pose"]) == {"pan", "lift", "elbow"}
    assert whole["signals"][0]["actuator"].endswith("_servo")
    assert set(whole["expected"]) == set(first.arm.hypotheses)
    assert whole["limits"]["speed"]["lift"] == {"limit": 3.14, "source": "assumed"}
    assert whole["limits"]["jerk"]["lift"] == {"limit": None, "source": None}
    peaks = whole["signals"][0]["peaks"]
    assert {"joint", "quantity", "of", "value", "limit", "source", "unit"} == set(peaks[0])
    assert all(p["limit"] is None or p["value"] <= p["limit"] * (1 + 1e-9) for p in peaks)


@pytest.mark.parametrize("kind", ["model", "velocity", "torque"])
def test_a_trajectory_has_the_fields_of_the_message(
    servoed: Path, tmp_path: Path, kind: Any
) -> None:
    formats = ("ros2",) if kind == "model" else ("ros2", "csv")
    motion = replace(ROS, signal_format=formats, commands=kind)
    made = plan(servoed, choice=FEW, own=PlanSettings(joint="elbow"), motion=motion)
    write_plan(files(tmp_path, made), made)
    assert (tmp_path / "signal.csv").exists() == (kind != "model")
    whole = yaml.safe_load((tmp_path / "signal.yaml").read_text("utf-8"))
    assert set(whole) == {"header", "joint_names", "points"}
    assert whole["joint_names"] == ["pan", "lift", "elbow"]
    points, signal = whole["points"], made.signals[0]
    assert len(points) == len(signal.time)
    assert {frozenset(p) for p in points} == {
        frozenset({"positions", "velocities", "accelerations", "effort", "time_from_start"})
    }
    at = [p["time_from_start"]["sec"] + 1e-9 * p["time_from_start"]["nanosec"] for p in points]
    assert np.diff(at) == pytest.approx(np.full(len(at) - 1, 0.004))
    assert at[0] == pytest.approx(0.004)
    assert points[-1]["positions"] == pytest.approx(made.pose, abs=1e-6)
    if kind == "model":
        elbow = [point["positions"][2] for point in points]  # behind a gear of 2
        assert elbow == pytest.approx(signal.commands["elbow_servo"] / 2, abs=1e-8)
        assert points[0]["velocities"] == points[-1]["velocities"] == [0, 0, 0]
    else:
        field = {"velocity": "velocities", "torque": "effort"}[kind]
        played = signal.played[f"{kind}.elbow"]
        found = [point[field][2] for point in points]  # numbers with exponents are numbers
        assert found == pytest.approx(played, rel=1e-7, abs=1e-12)


def test_motors_make_a_trajectory_of_torques_and_several_kinds_make_none(tmp_path: Path) -> None:
    made = plan(written(tmp_path, MOTORS), choice=FEW, motion=ROS)
    write_plan(files(tmp_path / "out", made), made)
    point = yaml.safe_load((tmp_path / "out" / "signal.yaml").read_text("utf-8"))["points"][0]
    assert point["effort"][1] == pytest.approx(20 * made.signals[0].commands["m2"][0], rel=1e-6)
    start, end = SERVOED.index('<position name="pan_servo"'), SERVOED.index('<position name="lift')
    motor = '<motor name="pan_servo" joint="pan" ctrlrange="-80 80"/>'
    mixed = written(tmp_path, SERVOED[:start] + motor + SERVOED[end:], "mixed.xml")
    made = plan(mixed, choice=FEW, motion=ROS)
    with pytest.raises(InvalidSetting, match=r"one kind of command for all joints.*--commands"):
        write_plan(files(tmp_path / "none", made), made)
    assert not (tmp_path / "none").exists()


def test_the_way_to_the_pose_keeps_within_a_share_of_the_limits(
    servoed: Path, tmp_path: Path
) -> None:
    own = PlanSettings(from_deg=(40.0, -30.0, 50.0), pose_deg=(20.0, -60.0, 70.0), hold_s=2.0)
    limits = {"speed": 1.0, "acceleration": 4.0, "jerk": 40.0}
    motion = MotionSettings(
        max_speed_rad_s=(1.0,), max_acceleration_rad_s2=(4.0,), max_jerk_rad_s3=(40.0,)
    )
    made = plan(servoed, choice=FEW, own=own, motion=motion)
    write_plan(files(tmp_path, made), made)
    whole = read(tmp_path / "plan.json")
    table = np.genfromtxt(tmp_path / "transit.csv", delimiter=",", names=True)
    assert table["time"][-1] == pytest.approx(whole["transit"]["duration_s"])
    way = np.stack([table[f"position{joint}"] for joint in made.arm.joints], axis=1)
    assert way[0] == pytest.approx(np.radians([40.0, -30.0, 50.0]))
    assert way[-1] == pytest.approx(made.pose)
    assert whole["transit"]["from_origin"] == "as given"
    rate = 1 / (table["time"][2] - table["time"][1])
    for power, limit in enumerate(limits.values(), start=1):
        assert np.abs(np.diff(way, n=power, axis=0)).max() * rate**power <= limit * (1 + 1e-2)


def test_runs_are_listed_with_reasons_and_become_a_recording(
    servoed: Path, first: Plan, tmp_path: Path
) -> None:
    write_plan(files(tmp_path, first), first)
    write_plan(files(tmp_path, first), first)  # nothing was measured: the same again
    recording, columns = tmp_path / "recording", play(first).columns
    listed = read(recording / "recording.json")["runs"]
    assert [run["file"] for run in listed] == [
        "run-01.csv", "repeat-01.csv", "repeat-02.csv", "reference-01.csv",
    ]  # fmt: skip
    assert [run.get("planned", False) for run in listed] == [False, True, True, True]
    assert listed[-1]["condition"] == "healthy"
    reasons = [run["reason"] for run in read(tmp_path / "plan.json")["runs"]]
    assert "drift and scatter" in reasons[1] and "healthy machine" in reasons[3]
    signal = (tmp_path / "first-signal.csv").read_text("utf-8")
    assert signal == (tmp_path / "signal.csv").read_text("utf-8")
    write_csv(recording / "run-01.csv", columns)
    (run,) = read_recording(recording).runs
    assert (run.name, run.excited) == ("run-01.csv", first.next.joints)
    assert run.pose == pytest.approx(first.next.pose)
    write_csv(recording / "reference-01.csv", columns)
    assert [run.condition for run in read_recording(recording).runs] == ["suspect", "healthy"]
    # Later plans keep the runs measured, and repeat the first one of the session.
    own = PlanSettings(pose_deg=(20.0, -60.0, 70.0), joint="elbow")
    later = plan(servoed, choice=FEW, own=own)
    write_plan(files(tmp_path, later), later)
    assert (tmp_path / "first-signal.csv").read_text("utf-8") == signal
    names = [run["file"] for run in read(recording / "recording.json")["runs"]]
    assert names[:3] == ["run-01.csv", "reference-01.csv", "run-02.csv"]
    repeat = next(r for r in read(tmp_path / "plan.json")["runs"] if r["kind"] == "repeat")
    assert repeat["pose"] == pytest.approx(dict(first.next.pose))
    assert (repeat["joint"], repeat["signal"]) == (first.next.joints[0], "first-signal")


def test_a_plan_cut_short_is_no_plan_and_is_written_anew(
    first: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(path: Path, columns: object) -> None:
        raise OSError(28, "No space left on device")

    write_plan(files(tmp_path, first), first)
    monkeypatch.setattr(signal_files, "write_parquet", full)
    with pytest.raises(OSError, match="No space"):
        write_plan(files(tmp_path, first), first)
    assert not (tmp_path / "plan.json").exists()  # nobody takes the halves for a plan
    monkeypatch.undo()
    write_plan(files(tmp_path, first), first)
    assert (tmp_path / "plan.json").exists()


def test_files_of_others_are_neither_overwritten_nor_removed(
    servoed: Path, motors: Path, first: Plan, tmp_path: Path
) -> None:
    out = tmp_path / "session"
    out.mkdir()
    for name in ("signal.csv", "plan.json"):
        (out / name).write_text("{}", encoding="utf-8")
        with pytest.raises(InvalidSetting, match=name.replace(".", r"\.")):
            files(out, first)
        (out / name).unlink()
    two = plan(servoed, choice=replace(FEW, in_turn=2))
    assert len(two.signals) == len(set(two.next.joints)) == 2
    write_plan(files(out, two), two)
    mine = [out / "signal-measured.csv", out / "signal-3.parquet", tmp_path / "precious.csv"]
    for path in mine:
        path.write_text("mine", encoding="utf-8")
    write_plan(files(out, first), first)  # signals that the earlier plan lists are removed
    assert not (out / "signal-2.csv").exists() and not (out / "signal-2.parquet").exists()
    whole = read(out / "plan.json")
    listed = ("../precious.csv", str(mine[-1]), "signal-measured.csv", 7, None, ["a"])
    whole["signals"] = [{"csv": each} for each in listed] + list(listed)
    (out / "plan.json").write_text(json.dumps(whole), encoding="utf-8")
    write_plan(files(out, first), first)
    before = (out / "plan.json").read_text("utf-8")
    (out / "signal-2.csv").write_text("mine", encoding="utf-8")
    with pytest.raises(InvalidSetting, match=r"signal-2\.csv.*no plan lists it"):
        write_plan(files(out, two), two)
    assert all(path.read_text("utf-8") == "mine" for path in (*mine, out / "signal-2.csv"))
    assert (out / "plan.json").read_text("utf-8") == before
    with pytest.raises(InvalidData, match="another model"):
        PlanFiles(out, read_arm(motors).recording_model.xml)
    with pytest.raises(InvalidSetting, match="is a file"):
        files(mine[-1], first)


# ------------------------------------------------------------------------- settings beside


@pytest.fixture(scope="module")
def limited(tmp_path_factory: pytest.TempPathFactory) -> Plan:
    """Plan for a URDF that states speeds, with a limit of jerk given."""
    model = written(tmp_path_factory.mktemp("limited"), URDF, "arm.urdf")
    slow = MotionSettings(max_jerk_rad_s3=(4000.0,), command_bandwidth_hz=90.0)
    return plan(model, choice=FEW, motion=slow)


def test_the_limits_of_a_plan_hold_for_every_recording_beside_it(
    limited: Plan, tmp_path: Path
) -> None:
    write_plan(files(tmp_path, limited), limited)
    before = session_beside(tmp_path / "recording")
    assert before == session_beside(tmp_path / "corrected") and before.limits is not None
    arm = tmp_path / "recording" / "model.xml"
    # The recording's MJCF does not state the speeds of the URDF; the plan does.
    limits = plan(arm, choice=FEW, motion=before.limits).limits
    assert [limits.limit("speed", j) for j in range(2)] == [2.0, 2.0]
    assert [limits.limit("jerk", j) for j in range(2)] == [4000.0, 4000.0]
    assert limits.limit("acceleration", 0) == float("inf")
    assert limits.bandwidth_hz == 90.0
    assert session_beside(tmp_path / "else" / "where").limits is None
    whole = read(tmp_path / "plan.json")
    del whole["limits"]  # as earlier versions wrote it
    (tmp_path / "plan.json").write_text(json.dumps(whole), "utf-8")
    assert session_beside(tmp_path / "recording").limits == before.motion
    (tmp_path / "plan.json").write_text('{"format": "another"}', "utf-8")
    assert session_beside(tmp_path / "recording").limits is None


def with_limits(value: Any) -> Callable[[bytes], bytes]:
    return lambda raw: json.dumps({**json.loads(raw), "limits": value}).encode()


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda raw: raw[: len(raw) // 2], "the plan is damaged"),
        (lambda raw: b"\xff" + raw, "the plan is damaged"),
        *((with_limits(value), "limits: ") for value in
          (3, [], {"speed": 3}, {"speed": {"j1": 2}}, {"speed": {"j1": {"limit": -1.0}}})),
    ],
)  # fmt: skip
def test_a_damaged_plan_is_refused_in_one_line(
    limited: Plan, tmp_path: Path, damage: Callable[[bytes], bytes], words: str
) -> None:
    write_plan(files(tmp_path, limited), limited)
    path = tmp_path / "plan.json"
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(InvalidData, match=rf"plan\.json: {words}") as error:
        session_beside(tmp_path / "recording")
    assert "\n" not in str(error.value)
