"""A changed unit, sign, order, clock or gravity is named before any effect, and corrected.

The torques come from MuJoCo's inverse dynamics with friction and a payload that the model lacks.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from loose_env.cli.main import main as loose
from loose_env.doctor import Correction, Finding, examine, write_corrected
from loose_env.errors import InvalidSetting
from loose_env.recording import Recording, Run, read_recording, write_recording
from tests.doctor.machine import JOINTS, each_run, record, with_sensors

WRONG = "run-1.parquet"
Columns = dict[str, np.ndarray]
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


def changed(change: Callable[[Columns, Columns], object]) -> list[Run]:
    found = []
    for run in SOUND:
        sensors, torques = dict(run.sensors), dict(run.torques)
        change(sensors, torques)
        found.append(replace(run, sensors=sensors, torques=torques))
    return found


def alike(recording: Recording, runs: Sequence[Run]) -> None:
    for own, true in zip(recording.runs, runs, strict=True):
        for name, values in true.sensors.items():
            np.testing.assert_allclose(own.sensors[name], values, atol=1e-9)


@pytest.fixture(scope="module")
def servo(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return record(tmp_path_factory.mktemp("doctor") / "servo")


def corrected(
    folder: Path, made: Sequence[Run], model: str = NOMINAL
) -> tuple[list[Finding], Recording]:
    """Errors that offer a correction, and the recording that those make, which has none."""
    wrong = write_recording(folder / "wrong", model_xml=model, runs=made)
    errors = [each for each in examine(wrong).errors if each.fix is not None]
    right = write_corrected(wrong, [each.fix for each in errors if each.fix], folder / "corrected")
    assert not examine(right).errors
    return errors, right


def exchanged(columns: Columns, one: str, other: str) -> None:
    columns[one], columns[other] = columns[other], columns[one]


CHANGES: dict[str, tuple[Callable[[Columns, Columns], object], str]] = {
    "reverse position": (
        lambda q, t: q.update(q_upper=-q["q_upper"]), "sensor.q_upper multiplied by -1"),
    "reverse torque": (lambda q, t: t.update(fore=-t["fore"]), "torque.fore multiplied by -1"),
    "exchange positions": (
        lambda q, t: exchanged(q, "q_upper", "q_fore"), "sensor.q_upper and sensor.q_fore ex"),
    "exchange torques": (
        lambda q, t: exchanged(t, "base", "upper"), "torque.base and torque.upper exchanged"),
    "degrees": (
        lambda q, t: q.update({n: np.degrees(v) for n, v in q.items()}), "multiplied by 0.0174533"),
    "late": (
        lambda q, t: t.update(
            {n: np.concatenate([np.repeat(v[0], 20), v[:-20]]) for n, v in t.items()}),
        "moved 100 ms towards the start"),
    "current": (lambda q, t: t.update(upper=t["upper"] / 8.5), "torque.upper multiplied by 8."),
}  # fmt: skip


@pytest.mark.parametrize("change", CHANGES)
def test_a_change_of_the_recording_is_named_and_corrected(tmp_path: Path, change: str) -> None:
    errors, right = corrected(tmp_path, changed(CHANGES[change][0]))
    offered = {each.fix.words for each in errors if each.fix}
    assert len(offered) == (3 if change == "degrees" else 1)
    assert all(CHANGES[change][1] in words for words in offered)
    assert "of the torques' variance" in errors[0].found
    if change != "late":
        alike(right, SOUND)


def test_degrees_of_one_run_are_confirmed_by_its_torques(tmp_path: Path) -> None:
    one, two = (
        replace(
            run,
            pose=dict.fromkeys(JOINTS, 0.5),
            sensors={n: q - q.mean() + 0.5 for n, q in run.sensors.items()},
        )
        for run in SOUND
    )
    wrong = replace(two, sensors={n: np.degrees(q) for n, q in two.sensors.items()})
    errors, right = corrected(tmp_path, [one, wrong])
    assert {each.run for each in errors} == {WRONG}
    assert any("of the torques' variance" in each.found for each in errors)
    alike(right, [one, two])


def test_gravity_that_points_elsewhere_is_named_with_its_direction(tmp_path: Path) -> None:
    truth = MODEL.format(gravity='gravity="6.937 0 -6.937"', mass=4)
    (finding,), right = corrected(tmp_path, runs(truth))
    assert finding.check == "gravity" and "45 degrees from the model's" in finding.found
    assert finding.fix is not None and finding.fix.vector is not None
    np.testing.assert_allclose(finding.fix.vector, [6.937, 0, -6.937], atol=0.2)
    np.testing.assert_allclose(right.model().opt.gravity, finding.fix.vector, atol=1e-3)


def test_a_pendulum_has_two_names_for_a_reversed_sign(tmp_path: Path) -> None:
    made = [replace(r, torques={"pivot": -r.torques["pivot"]}) for r in runs(PENDULUM)]
    (finding,), _ = corrected(tmp_path, made, PENDULUM)
    assert "torque.pivot" in finding.found and "sensor.q_pivot" in finding.found


def test_an_encoder_that_wraps_round_is_named_and_unwrapped(tmp_path: Path) -> None:
    time = np.arange(2000) / 200
    angle = 3.0 * np.sin(time) + 1.0
    wrapped = (angle + np.pi) % (2 * np.pi) - np.pi
    made = [Run(name="a.csv", time=time, sensors={"q_pivot": wrapped})]
    (finding,), right = corrected(tmp_path, made, PENDULUM)
    assert "4 times" in finding.found or "jumps by a turn" in finding.found
    np.testing.assert_allclose(right.runs[0].sensors["q_pivot"], angle, atol=1e-9)


@pytest.mark.parametrize(
    ("truth", "gains"),
    [
        (MODEL.format(gravity="", mass=2.8), {}),  # a payload, friction
        (MODEL.format(gravity="", mass=6), {}),
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
    report = examine(write_recording(tmp_path / "model", model_xml=NOMINAL, runs=made))
    assert not report.errors and not any(each.fix for each in report.findings), report.text()


def test_the_command_corrects_beside_and_only_when_asked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    home, out = tmp_path / "wrong", tmp_path / "corrected"
    write_recording(home, model_xml=NOMINAL, runs=changed(CHANGES["reverse position"][0]))
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


def test_ticks_are_named(tmp_path: Path) -> None:
    time = np.arange(2000) / 200
    ticks = np.round((np.sin(time) + 0.4 * np.sin(2.3 * time)) * 4096 / (2 * np.pi))
    made = [Run(name="a.csv", time=time, sensors={"q_pivot": ticks})]
    report = examine(write_recording(tmp_path / "ticks", model_xml=PENDULUM, runs=made))
    assert any("encoder ticks" in each.found for each in report.errors)


# ------------------------------------------------------------------------- one run alone


@pytest.mark.parametrize("poses", [True, False], ids=["poses noted", "limits alone"])
def test_degrees_of_one_run_are_found_and_corrected_there(
    servo: Recording, tmp_path: Path, poses: bool
) -> None:
    sound = servo
    if not poses:
        sound = each_run(servo, lambda run: replace(run, pose=None, controls={}))
    one = with_sensors(sound, "q_", np.degrees).runs[1]
    wrong = replace(sound, runs=(sound.runs[0], one, sound.runs[2]))
    report = examine(wrong)
    assert {(each.check, each.run, each.channel) for each in report.errors} == {
        ("units", WRONG, f"sensor.q_{joint}") for joint in JOINTS
    }
    fixes_ = [each.fix for each in report.errors if each.fix is not None]
    assert all(WRONG in fix.words for fix in fixes_)
    alike(write_corrected(wrong, fixes_, tmp_path / "corrected"), sound.runs)


def test_equal_changes_of_a_run_are_applied_once(servo: Recording, tmp_path: Path) -> None:
    twice = Correction(kind="scale", columns=("sensor.q_base",), factor=2.0)
    made = write_corrected(servo, [twice, twice.of(WRONG)], tmp_path / "made")
    for run, true in zip(made.runs, servo.runs, strict=True):
        np.testing.assert_array_equal(run.sensors["q_base"], 2 * true.sensors["q_base"])


def test_a_corrected_recording_keeps_format_dates_and_planned_runs(
    servo: Recording, tmp_path: Path
) -> None:
    home = tmp_path / "recording"
    runs = [
        replace(run, name=f"run-{k}.csv", time=run.time[:200],
                controls={n: v[:200] for n, v in run.controls.items()},
                sensors={n: v[:200] for n, v in run.sensors.items()})
        for k, run in enumerate(servo.runs)
    ]  # fmt: skip
    write_recording(home, model_xml=servo.model_path, runs=runs, file_format="csv")
    description = json.loads(home.joinpath("recording.json").read_text("utf-8"))
    planned = {"file": "repeat-01.csv", "excited": ["fore"], "planned": True}
    description["runs"].append(planned)
    home.joinpath("recording.json").write_text(json.dumps(description), "utf-8")
    for k in range(3):
        os.utime(home / f"run-{k}.csv", (1.6e9 + k, 1.6e9 + k))
    fix = Correction(kind="shift", columns=("sensor.q_base",), seconds=0.01)
    made = write_corrected(read_recording(home), [fix], tmp_path / "corrected")
    assert [run.name for run in made.runs] == ["run-0.csv", "run-1.csv", "run-2.csv"]
    times = [made.folder.joinpath(run.name).stat().st_mtime for run in made.runs]
    assert times == [1.6e9, 1.6e9 + 1, 1.6e9 + 2]
    entry = json.loads(made.folder.joinpath("recording.json").read_text("utf-8"))["runs"][-1]
    assert entry == {**planned, "condition": "suspect"}
    moved = made.runs[0].sensors["q_base"]
    assert np.isnan(moved[-10:]).all() and np.isfinite(moved[:-10]).all()


def test_findings_are_printed_where_the_corrected_recording_cannot_be_written(
    servo: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wrong = with_sensors(servo, "q_", np.degrees)
    home, out = tmp_path / "wrong", tmp_path / "taken"
    write_recording(home, model_xml=servo.model_path, runs=wrong.runs)
    out.mkdir()
    out.joinpath("notes.txt").write_text("of the user")
    assert loose(["doctor", str(home), "--fix", str(out)]) != 0
    printed = capsys.readouterr()
    assert "degrees instead of radians" in printed.out
    assert "not empty" in printed.err and "overwrite=True" not in printed.err
    assert [each.name for each in out.iterdir()] == ["notes.txt"]
