"""A changed unit, sign, order, clock or gravity is named before any effect, and corrected.

The torques come from MuJoCo's inverse dynamics with friction and a payload that the model lacks.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from loose_env.cli.main import main as loose
from loose_env.doctor import Report, examine, write_corrected
from loose_env.errors import InvalidSetting
from loose_env.recording import Recording, Run, read_recording, write_recording

JOINTS = ("base", "upper", "fore")
MODEL = """<mujoco><compiler angle="radian"/><option {gravity}/>
<default><joint axis="0 1 0"/></default>
<worldbody><body pos="0 0 .3"><joint name="base" axis="0 0 1"/>
 <inertial pos=".05 0 .1" mass="5" diaginertia=".04 .04 .02"/>
 <body pos="0 0 .2"><joint name="upper"/>
  <inertial pos=".2 .03 0" mass="{mass}" diaginertia=".01 .06 .06"/>
  <body pos=".4 0 0"><joint name="fore"/>
   <inertial pos=".15 0 .02" mass="2" diaginertia=".004 .02 .02"/>
</body></body></body></worldbody>
<sensor>{sensors}</sensor></mujoco>""".replace(
    "{sensors}", "".join(f'<jointpos name="q_{j}" joint="{j}"/>' for j in JOINTS)
)
NOMINAL = MODEL.format(gravity="", mass=4)
PENDULUM = """<mujoco><worldbody><body><joint name="pivot" axis="0 1 0"/>
<inertial pos="0 0 -.3" mass=".1" diaginertia="1e-5 1e-5 1e-5"/></body></worldbody>
<sensor><jointpos name="q_pivot" joint="pivot"/></sensor></mujoco>"""


def runs(truth: str, *, count: int = 2, seconds: float = 8.0) -> list[Run]:
    """Runs of sines with the torque that the truth needs, friction and noise."""
    model = mujoco.MjModel.from_xml_string(truth)
    data, names = mujoco.MjData(model), [model.joint(j).name for j in range(model.njnt)]
    rng, made = np.random.default_rng(3), []
    time = np.arange(round(seconds * 200)) / 200
    for k in range(count):
        w, phase = rng.uniform(1, 4, (2, model.nv)), rng.uniform(0, 6, (2, model.nv))
        at = time[:, None, None] * w + phase
        q, v = (0.6 * np.sin(at)).sum(1), (0.6 * w * np.cos(at)).sum(1)
        a = (-0.6 * w**2 * np.sin(at)).sum(1)
        torque = np.empty_like(q)
        for t in range(len(time)):
            data.qpos[:], data.qvel[:], data.qacc[:] = q[t], v[t], a[t]
            mujoco.mj_inverse(model, data)
            torque[t] = data.qfrc_inverse
        torque += 0.05 * torque.std(0) * np.sign(v) + 0.1 * torque.std(0) * v / v.std(0)
        torque += 0.02 * torque.std(0) * rng.normal(size=q.shape)
        q += rng.normal(0, 1e-4, q.shape)
        made.append(
            Run(
                name=f"run-{k}.csv",
                time=time,
                sensors={f"q_{j}": q[:, i] for i, j in enumerate(names)},
                torques={j: torque[:, i] for i, j in enumerate(names)},
            )
        )
    return made


SOUND = runs(NOMINAL)


def changed(
    change: Callable[[dict[str, np.ndarray], dict[str, np.ndarray]], None],
) -> list[Run]:
    found = []
    for run in SOUND:
        sensors, torques = dict(run.sensors), dict(run.torques)
        change(sensors, torques)
        found.append(replace(run, sensors=sensors, torques=torques))
    return found


def recorded(folder: Path, made: list[Run], model: str = NOMINAL) -> Recording:
    return write_recording(folder, model_xml=model, runs=made)


def fixes(report: Report) -> list[str]:
    return [each.fix.words for each in report.findings if each.fix is not None]


def reverse_position(sensors: dict, torques: dict) -> None:
    sensors["q_upper"] = -sensors["q_upper"]


def reverse_torque(sensors: dict, torques: dict) -> None:
    torques["fore"] = -torques["fore"]


def exchange_positions(sensors: dict, torques: dict) -> None:
    sensors["q_upper"], sensors["q_fore"] = sensors["q_fore"], sensors["q_upper"]


def exchange_torques(sensors: dict, torques: dict) -> None:
    torques["base"], torques["upper"] = torques["upper"], torques["base"]


def degrees(sensors: dict, torques: dict) -> None:
    for name in sensors:
        sensors[name] = np.degrees(sensors[name])


def late(sensors: dict, torques: dict) -> None:
    for name, values in torques.items():
        torques[name] = np.concatenate([np.repeat(values[0], 20), values[:-20]])


def current(sensors: dict, torques: dict) -> None:
    torques["upper"] = torques["upper"] / 8.5


CHANGES = {
    reverse_position: "sensor.q_upper multiplied by -1",
    reverse_torque: "torque.fore multiplied by -1",
    exchange_positions: "sensor.q_upper and sensor.q_fore exchanged",
    exchange_torques: "torque.base and torque.upper exchanged",
    degrees: "multiplied by 0.0174533",
    late: "moved 100 ms towards the start",
    current: "torque.upper multiplied by 8.",
}


@pytest.mark.parametrize("change", CHANGES)
def test_a_change_of_the_recording_is_named_and_corrected(tmp_path: Path, change: Callable) -> None:
    report = examine(recorded(tmp_path / "wrong", changed(change)))
    offered = set(fixes(report))
    assert len(offered) == (3 if change is degrees else 1), report.text()
    assert all(CHANGES[change] in words for words in offered), report.text()
    assert "of the torques' variance" in report.errors[0].found
    offered = [each.fix for each in report.errors if each.fix is not None]
    corrected = write_corrected(read_recording(tmp_path / "wrong"), offered, tmp_path / "corrected")
    assert not examine(corrected).errors
    if change is not late:
        for own, true in zip(corrected.runs, SOUND, strict=True):
            for name, values in true.sensors.items():
                np.testing.assert_allclose(own.sensors[name], values, atol=1e-9)


def test_degrees_of_one_run_are_confirmed_by_its_torques(tmp_path: Path) -> None:
    pose = dict.fromkeys(JOINTS, 0.5)
    made = [replace(run, pose=pose) for run in SOUND]
    shifted = [
        replace(run, sensors={n: q - q.mean() + 0.5 for n, q in run.sensors.items()})
        for run in made
    ]
    wrong = replace(shifted[1], sensors={n: np.degrees(q) for n, q in shifted[1].sensors.items()})
    report = examine(recorded(tmp_path / "one", [shifted[0], wrong]))
    offered = [each for each in report.errors if each.fix is not None]
    assert {each.run for each in offered} == {wrong.name.replace("csv", "parquet")}
    assert any("of the torques' variance" in each.found for each in offered)
    fixes_ = [each.fix for each in offered if each.fix is not None]
    read = read_recording(tmp_path / "one")
    corrected = write_corrected(read, fixes_, tmp_path / "corrected")
    for run, true in zip(corrected.runs, shifted, strict=True):
        for name, values in true.sensors.items():
            np.testing.assert_allclose(run.sensors[name], values, atol=1e-9)


def test_gravity_that_points_elsewhere_is_named_with_its_direction(tmp_path: Path) -> None:
    truth = MODEL.format(gravity='gravity="6.937 0 -6.937"', mass=4)
    report = examine(recorded(tmp_path / "tilted", runs(truth)))
    (finding,) = [each for each in report.errors if each.fix is not None]
    assert finding.check == "gravity" and "45 degrees from the model's" in finding.found
    assert finding.fix is not None and finding.fix.vector is not None
    np.testing.assert_allclose(finding.fix.vector, [6.937, 0, -6.937], atol=0.2)
    made = write_corrected(
        read_recording(tmp_path / "tilted"), [finding.fix], tmp_path / "corrected"
    )
    np.testing.assert_allclose(made.model().opt.gravity, finding.fix.vector, atol=1e-3)
    assert not examine(made).errors


@pytest.mark.parametrize("mass", [2.8, 4, 6])
def test_a_payload_and_friction_are_no_change_of_the_recording(tmp_path: Path, mass: float) -> None:
    report = examine(recorded(tmp_path / "sound", runs(MODEL.format(gravity="", mass=mass))))
    assert fixes(report) == []
    assert not report.errors


@pytest.mark.parametrize(
    ("truth", "gains"),
    [
        (NOMINAL, {"fore": 3.3}),
        (NOMINAL, {"base": 0.28}),
        (NOMINAL.replace('name="upper"', 'name="upper" stiffness="40"'), {}),
    ],
)
def test_an_error_of_the_model_is_no_change_of_the_recording(
    tmp_path: Path, truth: str, gains: dict[str, float]
) -> None:
    made = [
        replace(run, torques={j: t * gains.get(j, 1.0) for j, t in run.torques.items()})
        for run in runs(truth, count=1, seconds=6.0)
    ]
    report = examine(recorded(tmp_path / "model", made))
    assert fixes(report) == [] and not report.errors, report.text()


def test_a_pendulum_has_two_names_for_a_reversed_sign(tmp_path: Path) -> None:
    made = [
        replace(run, torques={"pivot": -run.torques["pivot"]}) for run in runs(PENDULUM, count=2)
    ]
    report = examine(recorded(tmp_path / "swing", made, PENDULUM))
    (finding,) = [each for each in report.errors if each.fix is not None]
    assert "torque.pivot" in finding.found and "sensor.q_pivot" in finding.found


def test_the_command_corrects_beside_and_only_when_asked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    home, out = tmp_path / "wrong", tmp_path / "corrected"
    recorded(home, changed(reverse_position))
    before = {f.name: f.read_bytes() for f in home.iterdir()}
    assert loose(["doctor", str(home)]) == 1
    assert "--fix DIR" in capsys.readouterr().out and not out.exists()
    assert loose(["doctor", str(home), "--fix", str(out)]) == 1
    assert "sensor.q_upper multiplied by -1" in capsys.readouterr().out.splitlines()[-1]
    assert {f.name: f.read_bytes() for f in home.iterdir()} == before
    assert loose(["doctor", str(out)]) == 0
    assert loose(["doctor", str(out), "--fix", str(tmp_path / "again")]) == 1
    assert "offers a correction" in capsys.readouterr().err
    with pytest.raises(InvalidSetting, match="not empty"):
        offered = [each.fix for each in examine(read_recording(home)).errors if each.fix]
        write_corrected(read_recording(home), offered, out)


def test_an_encoder_that_wraps_round_is_named_and_unwrapped(tmp_path: Path) -> None:
    time = np.arange(2000) / 200
    angle = 3.0 * np.sin(time) + 1.0
    wrapped = (angle + np.pi) % (2 * np.pi) - np.pi
    made = [Run(name="a.csv", time=time, sensors={"q_pivot": wrapped})]
    report = examine(recorded(tmp_path / "wrapped", made, PENDULUM))
    (finding,) = [each for each in report.errors if each.fix is not None]
    assert "4 times" in finding.found or "jumps by a turn" in finding.found
    assert finding.fix is not None
    corrected = write_corrected(
        read_recording(tmp_path / "wrapped"), [finding.fix], tmp_path / "whole"
    )
    np.testing.assert_allclose(corrected.runs[0].sensors["q_pivot"], angle, atol=1e-9)
    assert not examine(corrected).errors


@pytest.mark.parametrize("sign", [1, -1])
def test_ticks_are_named_and_converted_by_the_commands(tmp_path: Path, sign: int) -> None:
    servo = PENDULUM.replace(
        "</mujoco>",
        '<actuator><position name="s" joint="pivot" kp="5" kv=".1"/></actuator></mujoco>',
    )
    time = np.arange(2000) / 200
    command = np.sin(time) + 0.4 * np.sin(2.3 * time)
    ticks = np.round(sign * np.interp(time - 0.02, time, command) * 4096 / (2 * np.pi))
    made = [Run(name="a.csv", time=time, sensors={"q_pivot": ticks}, controls={"s": command})]
    report = examine(recorded(tmp_path / "ticks", made, servo))
    found = [each for each in report.errors if each.fix and "4096 ticks" in each.found]
    assert len(found) == 1 and found[0].fix is not None
    assert found[0].fix.factor == pytest.approx(sign * 2 * np.pi / 4096)


def test_servos_that_follow_each_others_commands_are_exchanged(tmp_path: Path) -> None:
    servos = "".join(f'<position name="s_{j}" joint="{j}" kp="90" kv="5"/>' for j in JOINTS)
    model = NOMINAL.replace("</mujoco>", f"<actuator>{servos}</actuator></mujoco>")
    time = np.arange(2000) / 200
    moves = {j: 0.5 * np.sin((1.3 + k) * time) for k, j in enumerate(JOINTS)}
    read = dict(moves) | {"upper": moves["fore"], "fore": moves["upper"]}
    made = Run(
        name="a.csv",
        time=time,
        controls={f"s_{j}": q for j, q in moves.items()},
        sensors={f"q_{j}": q for j, q in read.items()},
    )
    report = examine(recorded(tmp_path / "crossed", [made], model))
    assert "sensor.q_upper and sensor.q_fore exchanged" in fixes(report)
