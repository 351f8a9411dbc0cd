"""How commands act between their samples: found from the motion, stored, applied, told."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from loose_env.doctor import examine
from loose_env.errors import InvalidData
from loose_env.gap.core.motion import low_passed
from loose_env.gap.model.nominal_model import NominalModel
from loose_env.gap.runs import align_run, channels_of
from loose_env.importing import command_delays, drives_of, import_recording
from loose_env.recording import CommandTiming, Run, read_recording, write_recording

RATE, STEP = 50.0, 1e-3
ARM = """<mujoco><option timestep="0.001" integrator="implicitfast"/><worldbody>
  <body><joint name="lift" axis="0 1 0" armature="0.05" damping="0.3"/>
    <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" mass="1"/>
    <body pos="0.3 0 0"><joint name="bend" axis="0 1 0" armature="0.03" damping="0.2"/>
      <geom type="capsule" fromto="0 0 0 0.25 0 0" size="0.02" mass="0.6"/></body></body>
  </worldbody><actuator><position name="lift" joint="lift" kp="200" kv="8"/>
  <position name="bend" joint="bend" kp="120" kv="5"/></actuator>
  <sensor><jointpos name="lift_pos" joint="lift"/><jointpos name="bend_pos" joint="bend"/></sensor>
</mujoco>"""


def reference(time: float) -> np.ndarray:
    turn, fade = 2 * np.pi * time, min(time, 1.0)
    lift = 0.4 * np.sin(0.5 * turn) + 0.2 * np.sin(1.3 * turn)
    return fade * np.array([lift, 0.5 * np.sin(0.7 * turn) - 0.2 * np.sin(1.1 * turn)])


def played(*, held: bool, log_late_s: float = 0.0, friction: float = 0.0, hz: float = RATE) -> Run:
    """Log of an arm at `RATE` whose controller takes references, held at a rate or continuous."""
    model = mujoco.MjModel.from_xml_string(ARM)
    model.dof_frictionloss[0] = friction
    data, rows = mujoco.MjData(model), []
    for k in range(round(10 / STEP)):
        data.ctrl[:] = reference(np.floor(data.time * hz + 1e-9) / hz if held else data.time)
        if k % round(1 / (RATE * STEP)) == 0:
            logged = reference(
                np.floor(data.time * hz + 1e-9) / hz if held else data.time - log_late_s
            )
            rows.append([data.time, *logged, *data.qpos])
        mujoco.mj_step(model, data)
    time, lift, bend, *positions = np.array(rows).T
    return Run(
        name="run.csv", time=time, controls={"lift": lift, "bend": bend},
        sensors=dict(zip(("lift_pos", "bend_pos"), positions, strict=True)),
    )  # fmt: skip


def imported(folder: Path, run: Run, more: str = "") -> Run:
    columns = {f"ctrl.{n}": v for n, v in run.controls.items()}
    columns |= {f"sensor.{n}": v for n, v in run.sensors.items()}
    table = np.column_stack([run.time, *columns.values()])
    header = ",".join(["time", *columns])
    np.savetxt(folder / "log.csv", table, delimiter=",", header=header, comments="", fmt="%.9g")
    (folder / "arm.xml").write_text(ARM)
    lines = [f'"{c}" = {{ channel = "{c}"{more * c.startswith("ctrl")} }}' for c in columns]
    text = 'format = "loose-mapping/1"\nmodel = "arm.xml"\n[sources.log]\nfile = "log.csv"\n'
    text += (
        'time = { column = "time" }\n[columns]\n' + "\n".join(lines) + '\n[[runs]]\nfile = "run"\n'
    )
    (folder / "map.toml").write_text(text)
    return import_recording([folder / "log.csv"], folder / "map.toml", folder / "rec").runs[0]


def test_sampled_references_are_linear_though_a_joint_sticks(tmp_path: Path) -> None:
    run = imported(tmp_path, played(held=False, friction=1.0))
    assert run.commands == dict.fromkeys(("lift", "bend"), CommandTiming(mode="linear"))
    entry = json.loads((tmp_path / "rec" / "recording.json").read_text())["runs"][0]
    assert entry["commands"]["bend"] == {"mode": "linear", "shift_s": 0.0}


@pytest.mark.parametrize("hz", [RATE, 10.0])
def test_commands_that_the_drives_hold_stay_held(tmp_path: Path, hz: float) -> None:
    run = imported(tmp_path, played(held=True, hz=hz))
    assert run.commands == {} and "commands" not in (tmp_path / "rec/recording.json").read_text()


def test_references_logged_a_sample_late_act_before_their_stamps(tmp_path: Path) -> None:
    run = imported(tmp_path, played(held=False, log_late_s=1 / RATE))
    timing = run.timing("lift")
    assert timing.mode == "linear" and timing.shift_s == pytest.approx(-1 / RATE, abs=1.5e-3)


def test_a_mapping_decides_by_hand(tmp_path: Path) -> None:
    run = played(held=False)
    assert imported(tmp_path, run, ', method = "hold"').commands == {}
    held = tmp_path / "held"
    held.mkdir()
    lines = imported(held, played(held=True), ', method = "band"')
    assert lines.timing("lift") == CommandTiming(mode="linear")


def test_a_late_command_is_a_delay_of_the_drive_and_no_shift() -> None:
    run = played(held=False, log_late_s=-0.03)  # the log is ahead: drives act later
    delay = command_delays(mujoco.MjModel.from_xml_string(ARM), [run])["lift"]
    assert delay.seconds == pytest.approx(0.03, abs=2e-3) and delay.sd < 2e-3
    assert delay.interval == pytest.approx(1 / RATE)


def test_the_doctor_tells_drives_that_act_before_held_commands(tmp_path: Path) -> None:
    run = played(held=False)
    told = [one.found for one in examined(tmp_path / "held", run)]
    assert any("the drives act 9." in words and "before the commands" in words for words in told)
    lines = dict.fromkeys(run.controls, CommandTiming(mode="linear"))
    assert not examined(tmp_path / "linear", replace(run, commands=lines))
    assert not examined(tmp_path / "true", played(held=True))


@pytest.mark.parametrize("whole", [False, True])
def test_the_doctor_tells_motor_commands_without_gravity(tmp_path: Path, whole: bool) -> None:
    xml = re.sub(r"<position (name=\S+ joint=\S+) [^/]*/>", r"<motor \1/>", ARM)
    model = mujoco.MjModel.from_xml_string(xml)
    data, rows = mujoco.MjData(model), []
    for k in range(8000):
        mujoco.mj_forward(model, data)
        added = 120 * (reference(data.time) - data.qpos) - 8 * data.qvel
        data.ctrl[:] = added + data.qfrc_bias
        if k % 4 == 0:
            rows.append([data.time, *(data.ctrl if whole else added), *data.qpos])
        mujoco.mj_step(model, data)
    time, *columns = np.array(rows).T
    run = Run(
        name="r", time=time, controls=dict(zip(("lift", "bend"), columns[:2], strict=True)),
        sensors=dict(zip(("lift_pos", "bend_pos"), columns[2:], strict=True)),
    )  # fmt: skip
    found = examine(write_recording(tmp_path / "rec", model_xml=xml, runs=[run])).findings
    told = [one for one in found if one.check == "gravity"]
    assert [one.consequence for one in told] == ["under these commands the model falls"] * (
        not whole
    )


def examined(folder: Path, run: Run) -> list:
    return [
        one for one in examine(write_recording(folder, model_xml=ARM, runs=[run])).findings
        if one.check == "clock"
    ]  # fmt: skip


def test_the_gap_simulates_and_balances_what_acts() -> None:
    machine = NominalModel(mujoco.MjSpec.from_string(ARM))
    time = np.arange(200) / RATE
    values = np.sin(3 * time)
    timing = CommandTiming(mode="linear", shift_s=-0.004)
    run = Run(
        name="r", time=time, controls={"lift": values}, sensors={"lift_pos": values},
        commands={"lift": timing},
    )  # fmt: skip
    trial = align_run(run, machine, channels_of([run]), step=STEP)
    steps = np.arange(trial.steps) * trial.step
    inner = slice(50, -50)
    assert trial.controls[inner, 0] == pytest.approx(np.sin(3 * (steps + 0.0045))[inner], abs=1e-3)
    seen = low_passed(values[:, None], 10.0, 1 / RATE, [timing])[20:-20, 0]
    assert seen == pytest.approx(np.sin(3 * (time + 0.004))[20:-20], abs=1e-3)
    held = low_passed(values[:, None], 10.0, 1 / RATE, [CommandTiming()])[20:-20, 0]
    assert held == pytest.approx(np.sin(3 * (time - 0.5 / RATE))[20:-20], abs=1e-3)


def test_a_filter_makes_a_servo_late_and_a_negative_gain_makes_it_none() -> None:
    late = ARM.replace('kv="5"', 'kv="5" timeconst="0.03"').replace('name="bend" joint', "joint")
    lift, bend = drives_of(mujoco.MjModel.from_xml_string(late))
    assert (lift.name, lift.filter_s, bend.name, bend.filter_s) == ("lift", 0.0, "", 0.03)
    assert lift.follows and bend.follows
    assert (lift.lag, bend.lag) == pytest.approx((8.3 / 200, 5.2 / 120 + 0.03))
    away, _ = drives_of(mujoco.MjModel.from_xml_string(ARM.replace('kp="200"', 'kp="-200"')))
    assert away.sets == "position" and not away.follows


def test_recordings_keep_their_timings_and_refuse_others(tmp_path: Path) -> None:
    run = replace(played(held=True), commands={"lift": CommandTiming(shift_s=0.01)})
    place = write_recording(tmp_path / "rec", model_xml=ARM, runs=[run]).folder
    assert read_recording(place).runs[0].commands == run.commands
    assert read_recording(place).runs[0].timing("bend") == CommandTiming()
    file = place / "recording.json"
    text = file.read_text()
    for old, new, words in (
        (
            '"lift": {',
            '"lifts": {',
            r"runs\[0\].commands: 'lifts' is no actuator .* 'lift', 'bend'",
        ),
        ('"held"', '"cubic"', r"runs\[0\].commands.lift.mode"),
        ("0.01", "7.0", r"runs\[0\].commands.lift.shift_s"),
    ):
        file.write_text(text.replace(old, new))
        with pytest.raises(InvalidData, match=words):
            read_recording(place)
