"""Mappings guessed from signals: joints, units and signs; and each format imported by them."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import pytest

from loose_env.cli.main import main
from loose_env.importing import inverse_dynamics, proposal_text, propose, smoothed
from loose_env.importing.messages import _numbers
from loose_env.recording import Recording, read_recording
from tests.importing.arm_log import (
    ARM,
    JOINTS,
    START_NS,
    Motion,
    moved,
    write_bag,
    write_lerobot,
    write_robomimic,
    write_rtde,
)

MODEL = mujoco.MjModel.from_xml_string(ARM)
COMMANDS = ("pan", "lift", "bend")
ALL = {f"sensor.{n}_pos" for n in JOINTS} | {f"ctrl.{n}" for n in COMMANDS}
RATES = {f"sensor.{n}_vel" for n in JOINTS}
POSITIONS, ORDERS = (" ".join(f"{j}_{word}" for j in JOINTS) for word in ("pos", "cmd"))


@pytest.fixture
def motion() -> Motion:
    return moved()


@pytest.fixture
def home(tmp_path: Path) -> Path:
    """A folder with ``arm.xml``."""
    tmp_path.joinpath("arm.xml").write_text(ARM)
    return tmp_path


# ------------------------------------------------------------------------- formats


def guessed(home: Path, files: Sequence[Path], *options: str) -> dict:
    """Columns of the mapping that --guess writes."""
    told = ["import", "--guess", *map(str, files), "--model", str(home / "arm.xml")]
    assert main([*told, "--mapping", str(home / "map.toml"), *options]) == 0
    return tomllib.loads((home / "map.toml").read_text())["columns"]


def imported(home: Path, files: Sequence[Path]) -> Recording:
    told = ["import", *map(str, files), "--mapping", str(home / "map.toml")]
    assert main([*told, "--out", str(home / "out")]) == 0
    return read_recording(home / "out")


def check(recording: Recording, motion: Motion, *, digits: float = 1e-6) -> None:
    """The known motion, in SI units, under the model's names."""
    for run in recording.runs:
        assert len(run.time) == len(motion.time)
        for i, (joint, command) in enumerate(zip(JOINTS, COMMANDS, strict=True)):
            read = run.sensors[f"{joint}_pos"]
            np.testing.assert_allclose(read, motion.position[:, i], atol=digits)
            np.testing.assert_allclose(run.controls[command], motion.command[:, i], atol=digits)


WRITERS: dict[str, Callable[[Path, Motion], list[Path]]] = {
    "rtde": lambda home, m: [write_rtde(home / "log.csv", m)],
    "rtde without header": lambda home, m: [write_rtde(home / "log.csv", m, header=False)],
    "rtde with commas": lambda home, m: [write_rtde(home / "log.csv", m, separator=",")],
    "rosbag2 sqlite3": lambda home, m: [write_bag(home / "bag", m)],
    "rosbag2 sqlite3 packed": lambda home, m: [write_bag(home / "bag", m, packed=True)],
    "rosbag2 before Iron": lambda home, m: [write_bag(home / "bag", m, definitions=False)],
    "rosbag2 mcap": lambda home, m: [write_bag(home / "bag", m, storage="mcap")],
    "robomimic": lambda home, m: [write_robomimic(home / "demos.hdf5", m)],
    "a single db3 file": lambda home, m: list(write_bag(home / "bag", m).glob("*.db3")),
}


@pytest.mark.parametrize("kind", list(WRITERS))
def test_a_guessed_mapping_imports_the_known_motion(home: Path, motion: Motion, kind: str) -> None:
    files = WRITERS[kind](home, motion)
    columns = guessed(home, files)
    assert set(columns) - {f"torque.{n}" for n in JOINTS} == ALL | RATES
    check(imported(home, files), motion)


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_episodes_of_lerobot_become_runs(home: Path, motion: Motion, version: str) -> None:
    files = [write_lerobot(home / "set", motion, version=version)]
    columns = guessed(home, files)
    assert set(columns) == ALL
    assert {each["unit"] for each in columns.values()} == {"deg"}
    recording = imported(home, files)
    names = [Path(run.name).stem for run in recording.runs]
    assert names == ["set-episode_000000", "set-episode_000001"]
    check(recording, motion, digits=1e-5)  # float32 degrees


def test_chosen_episodes_alone_are_imported(home: Path, motion: Motion) -> None:
    files = [write_lerobot(home / "set", motion, episodes=4)]
    guessed(home, files)
    text = (home / "map.toml").read_text()
    (home / "map.toml").write_text(text.replace('episodes = "all"', "episodes = [1, 3]"))
    names = [Path(run.name).stem for run in imported(home, files).runs]
    assert names == ["set-episode_000001", "set-episode_000003"]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["rtde", "rosbag2 sqlite3"])
def test_the_gap_of_an_imported_log_names_the_friction_of_the_elbow(home: Path, kind: str) -> None:
    # Less would pass for the tolerance of the drive's velocity gain, which acts in the same way.
    (log,) = map(str, WRITERS[kind](home, moved(friction=4.0)))
    model, mapping = str(home / "arm.xml"), home / "map.toml"
    told = ["import", "--guess", log, "--model", model, "--mapping", str(mapping)]
    assert main(told) == 0
    # By the commands alone, and one log cut into the two runs that a fit and its check need.
    lines = mapping.read_text().splitlines()
    text = "\n".join(line for line in lines if not line.startswith('"torque.'))
    first, second = "\nstart = 0.0\nstop = 3.9\n", "\nfile = 'b'\nstart = 4.0\nstop = 7.9\n"
    mapping.write_text(f"{text}{first}[[runs]]{second}")
    assert main(["import", log, "--mapping", str(mapping), "--out", str(home / "out")]) == 0
    told = ["gap", str(home / "out"), "--out", str(home / "gap")]
    told += ["--kinds", "viscous_friction", "--threads", "1"]
    assert main(told) == 0
    result = json.loads((home / "gap" / "result.json").read_text())
    (effect,) = result["effects"]
    assert (effect["kind"], effect["where"]) == ("viscous_friction", "elbow")
    before, after = result["gap"]["by_quantity"]["joint position [rad]"]
    assert after < 0.2 * before


# ------------------------------------------------------------------------- guesses


def table(path: Path, *columns: np.ndarray) -> str:
    np.savetxt(path, np.hstack([np.reshape(c, (len(c), -1)) for c in columns]), delimiter=",",
               fmt="%.10g")  # fmt: skip
    return str(path)


def lines(source: str, rate_hz: float | None = None) -> dict[str, tuple[str, str, int]]:
    """Channel, unit and sign of each column that is proposed."""
    return {
        each.column: (each.candidate.key.channel, each.scaling.unit, each.scaling.sign)
        for each in propose([source], MODEL, rate_hz).columns
        if not each.open
    }


def test_degrees_reversed_and_shuffled_columns_of_a_nameless_table(
    home: Path, motion: Motion
) -> None:
    order = [2, 0, 1]
    command = np.degrees(motion.command * [1, -1, 1])[:, order]
    source = table(home / "log.csv", 1e3 * motion.time, np.degrees(motion.position),
                   -np.degrees(motion.velocity), command)  # fmt: skip
    found = lines(source)
    for i, (joint, command) in enumerate(zip(JOINTS, COMMANDS, strict=True)):
        assert found[f"sensor.{joint}_pos"] == (str(2 + i), "deg", 1)
        assert found[f"sensor.{joint}_vel"] == (str(5 + i), "deg/s", -1)
        own = (str(8 + order.index(i)), "deg", 1)
        # A joint that moves against its command does not tell whose sign is reversed.
        assert found.get(f"ctrl.{command}") == (None if joint == "shoulder_lift" else own)


def test_a_table_without_times_needs_a_rate(
    home: Path, motion: Motion, capsys: pytest.CaptureFixture[str]
) -> None:
    source = table(home / "log.csv", motion.position, motion.velocity)
    told = ["import", "--guess", source, "--model", str(home / "arm.xml")]
    told += ["--mapping", str(home / "map.toml")]
    assert main(told) == 1
    assert "give the sampling rate by --rate-hz" in capsys.readouterr().err
    assert not (home / "map.toml").exists()
    assert main([*told, "--rate-hz", "125"]) == 0
    whole = tomllib.loads((home / "map.toml").read_text())
    assert whole["sources"]["log"]["time"] == {"rate_hz": 125}


def test_a_mapping_is_replaced_only_when_asked(
    home: Path, motion: Motion, capsys: pytest.CaptureFixture[str]
) -> None:
    source = str(write_rtde(home / "log.csv", motion))
    (home / "map.toml").write_text("mine")
    told = ["import", "--guess", source, "--model", str(home / "arm.xml")]
    told += ["--mapping", str(home / "map.toml")]
    assert main(told) == 1
    assert "--overwrite replaces it" in capsys.readouterr().err
    assert (home / "map.toml").read_text() == "mine"
    assert main([*told, "--overwrite"]) == 0
    assert capsys.readouterr().out.strip() == (home / "map.toml").read_text().strip()


def test_currents_are_left_open_with_a_factor(home: Path, motion: Motion) -> None:
    found = propose([str(write_rtde(home / "log.csv", motion))], MODEL).columns
    open_ones = [each for each in found if each.open]
    assert [each.column for each in open_ones] == [f"torque.{joint}" for joint in JOINTS]
    for each in open_ones:
        assert "torque constant" in each.reason
        assert each.scaling.scale == pytest.approx(12, rel=0.35)


def test_normalised_states_are_scaled_to_the_limits(home: Path, motion: Motion) -> None:
    narrow = mujoco.MjModel.from_xml_string(ARM.replace('range="-1.6 1.6"', 'range="-1.2 1.2"'))
    half = narrow.jnt_range[:, 1]
    state = 100 * motion.position / half
    assert np.ptp(state[:, 2]) > 1.1 * 2 * np.degrees(half[2])  # the elbow's are no degrees
    folder = write_lerobot(home / "set", motion, state=state, action=100 * motion.command / half)
    found = {each.column: each for each in propose([str(folder)], narrow).columns}
    for i, (joint, command) in enumerate(zip(JOINTS, COMMANDS, strict=True)):
        for column in (f"sensor.{joint}_pos", f"ctrl.{command}"):
            assert found[column].scaling.scale == pytest.approx(half[i] / 100)
            assert found[column].scaling.unit == "rad"
    assert "normalised to -100..100 of the limits" in found["sensor.elbow_pos"].reason
    proposal = propose([str(write_lerobot(home / "degrees", motion))], MODEL)
    assert "values normalised to -100..100 would look alike" in proposal.columns[0].reason


def test_joints_without_a_sensor_are_noted_with_the_line_to_add(home: Path, motion: Motion) -> None:
    bare = mujoco.MjModel.from_xml_string(
        ARM.replace('<jointpos name="elbow_pos" joint="elbow"/>', "")
    )
    proposal = propose([str(write_rtde(home / "log.csv", motion))], bare)
    assert any('<jointpos name="elbow_position" joint="elbow"/>' in note for note in proposal.notes)


WITH_TOOL = mujoco.MjModel.from_xml_string(
    ARM.replace('<inertial pos=".1 0 0"', '<site name="tool"/><inertial pos=".1 0 0"').replace(
        "</sensor>", '<accelerometer name="tip" site="tool"/></sensor>'
    )
)


def written(path: Path, columns: dict[str, np.ndarray]) -> str:
    table, header = np.stack(list(columns.values()), axis=1), ",".join(columns)
    np.savetxt(path, table, delimiter=",", fmt="%.10g", header=header, comments="")
    return str(path)


def logged(path: Path, motion: Motion, *, time: str = "Zeit") -> str:
    """Table of a logger with units in its names, times in milliseconds, and vibration."""
    vibration = np.gradient(np.gradient(motion.position, axis=0), axis=0)
    columns = {time: 1e3 * motion.time}
    columns |= {f"Achse {'ABC'[i]} [deg]": np.degrees(motion.position[:, i]) for i in range(3)}
    columns |= {f"Soll {'ABC'[i]} [deg]": np.degrees(motion.command[:, i]) for i in range(3)}
    columns |= {f"a{'xyz'[i]} [g]": vibration[:, i] for i in range(3)}
    columns["Druck [V]"] = motion.position[:, 1] ** 2
    return written(path, columns)


def test_channels_have_the_quantity_of_their_stated_units(home: Path, motion: Motion) -> None:
    proposal = propose([logged(home / "log.csv", motion)], WITH_TOOL)
    found = {each.column: each for each in proposal.columns if not each.open}
    units = {column: each.scaling.unit for column, each in found.items()}
    assert {f"sensor.tip.{axis}": "g" for axis in "xyz"}.items() <= units.items()
    for i, joint in enumerate(JOINTS):
        assert found[f"sensor.{joint}_pos"].candidate.key.channel == f"Achse {'ABC'[i]} [deg]"
    assert not any("[g]" in e.candidate.key.channel for e in proposal.columns if e.open)
    assert [left.candidate.key.channel for left in proposal.unassigned] == ["Druck [V]"]
    text = proposal_text(proposal, "arm.xml")
    assert '# "sensor.?" = { channel = "Druck [V]", unit = "V" }  # no role; most like' in text


@pytest.mark.parametrize("name", ["Zeit", "counter"])
def test_times_without_a_unit_get_it_from_their_steps(
    home: Path, motion: Motion, name: str
) -> None:
    proposal = propose([logged(home / "log.csv", motion, time=name)], WITH_TOOL)
    (line,) = (each for each in proposal.logs["log"].lines if each.startswith("time"))
    assert f'column = "{name}", unit = "ms" }}  # ' in line


@pytest.mark.parametrize(("unit", "factor"), [("mrad", 1e3), ("arcmin", 60 * 180 / np.pi)])
def test_a_stated_unit_of_the_quantity_stays(
    home: Path, motion: Motion, unit: str, factor: float
) -> None:
    columns = {f"{j}_pos [{unit}]": factor * motion.position[:, i] for i, j in enumerate(JOINTS)}
    found = lines(written(home / "log.csv", {"time": motion.time, **columns}))
    assert [found[f"sensor.{joint}_pos"][1] for joint in JOINTS] == [unit] * 3


def test_a_position_with_the_unit_of_another_quantity_is_left(home: Path, motion: Motion) -> None:
    units = ("rad", "g", "rad")
    columns = {f"{JOINTS[i]}_pos [{units[i]}]": motion.position[:, i] for i in range(3)}
    proposal = propose([written(home / "log.csv", {"time": motion.time, **columns})], MODEL)
    assert "sensor.shoulder_lift_pos" not in {e.column for e in proposal.columns if not e.open}
    assert [left.candidate.key.channel for left in proposal.unassigned] == ["shoulder_lift_pos [g]"]


@pytest.mark.parametrize(
    ("names", "run"),
    [("sweep sweep-acc", "sweep"), ("robot-7 cmd-7", "run-07"), ("states commands", "run-01"),
     ("run-03.robot run-03.cmd", "run-03")],
)  # fmt: skip
def test_a_run_of_two_files_has_the_name_that_both_share(
    home: Path, motion: Motion, names: str, run: str
) -> None:
    first, second = (f"{home}/{name}.csv" for name in names.split())
    position, command = motion.position.T, motion.command.T
    written(
        Path(first), {"time": motion.time, **dict(zip(POSITIONS.split(), position, strict=True))}
    )
    written(Path(second), {"time": motion.time, **dict(zip(ORDERS.split(), command, strict=True))})
    text = proposal_text(propose([first, second], MODEL), "arm.xml")
    assert tomllib.loads(text)["runs"][0]["file"] == run


def test_files_of_a_folder_are_one_run(home: Path, motion: Motion) -> None:
    for k, folder in enumerate((home / "a", home / "b")):
        folder.mkdir()
        for name, own in (("states", motion.position), ("commands", motion.command)):
            columns = dict(zip(JOINTS, np.roll(own, 100 * k, axis=0).T, strict=True))
            written(folder / f"{name}.csv", {"time": motion.time, **columns})
    proposal = propose([str(home / "a"), str(home / "b")], MODEL)
    runs = [sorted(run.values()) for run in proposal.runs]
    assert 'file = "a"' in proposal_text(proposal, "arm.xml")
    assert runs == [[f"{k}/commands.csv", f"{k}/states.csv"] for k in "ab"]
    assert len([each for each in proposal.columns if not each.open]) == 6


def test_a_channel_may_have_the_name_of_a_drive_and_a_tendon_one_command(
    home: Path, motion: Motion
) -> None:
    driven = '<position name="bend" joint="elbow" kp="200" kv="10"/>'
    tendon = ARM.replace(driven, driven.replace('joint="elbow"', 'tendon="belt"')).replace(
        "<actuator>", '<tendon><fixed name="belt"><joint joint="elbow" coef="1"/></fixed></tendon>'
        "<actuator>")  # fmt: skip
    names = ("pan", "lift", "bend")
    columns = dict(zip([f"{n} actual" for n in names], motion.position.T, strict=True))
    columns |= dict(zip([f"{n} cmd" for n in names], motion.command.T, strict=True))
    path = written(home / "log.csv", {"time": motion.time, **columns})
    found = {c.column: c for c in propose([path], mujoco.MjModel.from_xml_string(tendon)).columns}
    for joint, name in zip(JOINTS, names, strict=True):
        assert found[f"sensor.{joint}_pos"].candidate.key.channel == f"{name} actual"
        assert found[f"ctrl.{name}"].candidate.key.channel == f"{name} cmd"


def test_counts_of_an_encoder_are_scaled_by_the_command_that_they_follow(
    home: Path, motion: Motion
) -> None:
    words = np.round(motion.position * 2**16 / (2 * np.pi)).astype(int) % 2**16
    columns = {f"enc {i}": words[:, i] for i in range(3)}
    columns |= {f"cmd {i}": motion.command[:, i] for i in range(3)}
    found = propose([written(home / "log.csv", {"time": motion.time, **columns})], MODEL).columns
    scales = {e.column: e.scaling.scale * 2**16 / (2 * np.pi) for e in found if e.candidate.period}
    assert scales == pytest.approx(dict.fromkeys([f"sensor.{j}_pos" for j in JOINTS], 1), rel=0.05)


def test_turns_are_told_by_turns_a_minute(home: Path, motion: Motion) -> None:
    columns = {f"n_{i}": motion.velocity[:, i] * 30 / np.pi for i in range(3)}
    columns |= {f"phi_{i}": motion.position[:, i] / (2 * np.pi) for i in range(3)}
    found = lines(written(home / "log.csv", {"time": motion.time, **columns}))
    assert found == {f"sensor.{j}_pos": (f"phi_{i}", "rev", 1) for i, j in enumerate(JOINTS)} | {
        f"sensor.{j}_vel": (f"n_{i}", "rpm", 1) for i, j in enumerate(JOINTS)
    }


@pytest.mark.parametrize("witness", ["command", "torque", "accelerometer"])
@pytest.mark.parametrize(("unit", "size"), [("deg", 0.2), ("rad", 18.0)])
def test_a_witness_tells_the_unit_of_joints_without_limits(
    home: Path, motion: Motion, witness: str, unit: str, size: float
) -> None:
    tip = '<accelerometer name="tip" site="tip"/>'
    arm = re.sub(r' range="[^"]*" limited="true"', "", ARM).replace("<sensor>", f"<sensor>{tip}")
    arm = re.sub("(<body name=.lower.[^>]*>)", r'\1<site name="tip" pos=".2 0 0"/>', arm)
    free, step = mujoco.MjModel.from_xml_string(arm), motion.time[1] - motion.time[0]
    motions = [smoothed(smoothed(size * motion.position, 9), 9)]
    motions += [np.gradient(motions[0], step, axis=0)]
    motions += [np.gradient(motions[1], step, axis=0)]
    felt = np.zeros((len(motion.time), free.nsensordata))
    torque = inverse_dynamics(free, *motions, felt)
    felt += 0.2 * np.random.default_rng(0).normal(size=felt.shape)
    beside = {
        "command": zip([f"{n}_cmd [rad]" for n in COMMANDS], size * motion.command.T, strict=True),
        "torque": zip([f"{j}_torque" for j in JOINTS], torque.T, strict=True),
        "accelerometer": zip(("acc_x", "acc_y", "acc_z"), felt.T[:3] / 9.81, strict=True),
    }
    own = size * (np.degrees(motion.position) if unit == "deg" else motion.position)
    columns = {f"{j}_pos": own[:, i] for i, j in enumerate(JOINTS)} | dict(beside[witness])
    proposal = propose([written(home / "log.csv", {"time": motion.time, **columns})], free)
    found = {e.column: e.scaling.unit for e in proposal.columns if e.column.endswith("_pos")}
    assert found == dict.fromkeys([f"sensor.{j}_pos" for j in JOINTS], unit)


def test_turns_that_wrap_are_unwrapped(home: Path, motion: Motion) -> None:
    columns = {f"{j}_pos [rev]": motion.position[:, i] / 2 % 1 for i, j in enumerate(JOINTS)}
    proposal = propose([written(home / "log.csv", {"time": motion.time, **columns})], MODEL)
    assert [e.candidate.period for e in proposal.columns] == [1.0, 1.0, 1.0]


def test_numbered_channels_are_a_vector_beside_a_sensor_of_another_file(
    home: Path, motion: Motion
) -> None:
    slow = slice(None, None, 4)
    columns = {"elapsed": motion.time[slow]}
    columns |= {f"ax{i}_tgt": motion.command[slow, i] for i in range(3)}
    columns |= {f"ax{i}_deg": np.degrees(motion.position[slow, i]) for i in range(3)}
    columns |= {f"ax{i}_temp": 30 + motion.position[slow, i] ** 2 for i in range(3)}
    imu = {
        "elapsed": motion.time,
        **dict(zip(("accX", "accY", "accZ"), motion.torque.T, strict=True)),
    }
    files = [written(home / "arm.csv", columns), written(home / "imu.csv", imu)]
    found = {e.column: e.candidate.key.channel for e in propose(files, MODEL).columns}
    assert found == {f"sensor.{j}_pos": f"ax{i}_deg" for i, j in enumerate(JOINTS)} | {
        f"ctrl.{c}": f"ax{i}_tgt" for i, c in enumerate(COMMANDS)
    }


def test_times_may_be_two_nameless_columns_or_stand_beside_a_duration(
    home: Path, motion: Motion
) -> None:
    stamps = START_NS + np.round(motion.time * 1e9).astype(np.int64)
    rows = np.hstack([motion.position, motion.velocity])
    with (home / "bare.csv").open("w") as file:
        for ns, row in zip(stamps, rows, strict=True):
            file.write(",".join(map(str, [ns // 10**9, ns % 10**9, *row])) + "\n")
    proposal = propose([str(home / "bare.csv")], MODEL)
    assert proposal.logs["bare"].lines == ['time = { column = "1", fine = "2" }']
    columns = {"loop_us": 800 + 10 * np.sin(9 * motion.time), "cycle": 1e3 * motion.time + 5}
    columns |= {f"{j}_pos": motion.position[:, i] for i, j in enumerate(JOINTS)}
    (line,) = propose([written(home / "log.csv", columns)], MODEL).logs["log"].lines
    assert line.startswith('time = { column = "cycle", unit = "ms" }') and "not log.csv" in line


def test_a_position_by_name_is_no_velocity_for_the_joint_in_it(home: Path, motion: Motion) -> None:
    columns = {f"{j} position": motion.position[:, i] for i, j in enumerate(JOINTS)}
    columns |= {f"{j} angle": np.roll(motion.command[:, i], -60) for i, j in enumerate(JOINTS)}
    proposal = propose([written(home / "log.csv", {"time": motion.time, **columns})], MODEL)
    assert {e.column for e in proposal.columns} <= ALL


def test_states_that_only_torques_tell_to_be_exchanged(home: Path, motion: Motion) -> None:
    named = (0, 2, 1)
    columns = {f"{j}_effort": motion.torque[:, i] for i, j in enumerate(JOINTS)}
    columns |= {f"{JOINTS[k]}_position": motion.position[:, i] for i, k in enumerate(named)}
    proposal = propose([written(home / "log.csv", {"time": motion.time, **columns})], MODEL)
    found = {each.column: each.candidate.key.channel for each in proposal.columns}
    assert all(found[f"sensor.{JOINTS[i]}_pos"] == f"{JOINTS[k]}_position"
               for i, k in enumerate(named))  # fmt: skip
    assert all(found[f"torque.{joint}"] == f"{joint}_effort" for joint in JOINTS)


def test_names_in_cells_may_stand_behind_a_frame(home: Path, motion: Motion) -> None:
    stamps = START_NS + np.round(motion.time * 1e9).astype(np.int64)
    rows = zip(stamps, np.hstack([motion.position, motion.velocity]), strict=True)
    (home / "echo.csv").write_text("".join(
        f"{ns // 10**9},{ns % 10**9},base_link,{','.join([*JOINTS, *map(str, values)])}\n"
        for ns, values in rows
    ))  # fmt: skip
    assert guessed(home, [home / "echo.csv"]).keys() == RATES | {f"sensor.{j}_pos" for j in JOINTS}


def test_values_in_no_known_unit_are_named_where_nothing_else_is(
    home: Path, motion: Motion
) -> None:
    columns = {f"{j}_enc": 1e5 * motion.position[:, i] for i, j in enumerate(JOINTS)}
    refused = propose([written(home / "log.csv", {"time": motion.time, **columns})], MODEL).refused
    assert "elbow_enc: position by its name" in refused and "give unit and scale" in refused


def test_channels_are_what_they_do_beside_like_names(home: Path, motion: Motion) -> None:
    tick, words = 2 * np.pi / 4096, {"time": motion.time}
    for i, joint in enumerate(JOINTS):
        own, speed = np.round(motion.position[:, i] / tick), np.round(motion.velocity[:, i] / tick)
        words |= {f"motor_pos_{joint}": 101 * motion.position[:, i], f"q_{joint}": own + 2048,
                  f"qd_{joint}": np.round(motion.command[:, i] / tick) + 2048,
                  f"speed_{joint}": np.where(speed < 0, 2**15 - speed, speed),
                  f"tau_{joint}_d": motion.torque[:, i]}  # fmt: skip
    proposal = propose([written(home / "log.csv", words)], MODEL)
    found = {e.column: (e.candidate.key.channel, e.scaling.factor) for e in proposal.columns}
    for joint, drive in zip(JOINTS, COMMANDS, strict=True):
        assert found[f"sensor.{joint}_pos"] == (f"q_{joint}", pytest.approx(tick))
        assert found[f"ctrl.{drive}"] == (f"qd_{joint}", pytest.approx(tick))
        assert found[f"sensor.{joint}_vel"] == (f"speed_{joint}", pytest.approx(tick))
        assert f"torque.{joint}" not in found


def test_names_of_joints_hold_for_all_arrays_of_a_message() -> None:
    @dataclass
    class Point:
        positions: np.ndarray

    @dataclass
    class State:
        joint_names: list[str]
        actual: Point
        each: list[Point]

    entries = [Point(np.array([3.0])), Point(np.array([4.0]))]
    message = State(["elbow", "pan"], Point(np.array([1.0, 2.0])), entries)
    assert [*_numbers(message, "", ())] == [
        ("actual.positions", ("elbow", "pan"), [1.0, 2.0]),
        ("each[elbow].positions", ("0",), [3.0]), ("each[pan].positions", ("0",), [4.0]),
    ]  # fmt: skip


def test_channels_of_a_second_robot_are_another_vector(home: Path, motion: Motion) -> None:
    model = mujoco.MjModel.from_xml_string(
        re.sub("|".join(JOINTS), lambda m: f"joint_{JOINTS.index(m[0]) + 1}", ARM)
    )
    columns = {"time": motion.time}
    for robot, shift in ((1, 0), (2, 300)):
        position, command = (np.roll(x, shift, axis=0) for x in (motion.position, motion.command))
        for i in range(3):
            columns[f"ROB_{robot} Joint {i + 1} Pos"] = position[:, i]
            columns[f"ROB_{robot} Joint {i + 1} Ref"] = command[:, i]
    proposal = propose([written(home / "log.csv", columns)], model)
    taken = {e.candidate.key.channel for e in proposal.columns if not e.open}
    assert taken == {f"ROB_1 Joint {i} {word}" for i in (1, 2, 3) for word in ("Pos", "Ref")}


def test_a_word_that_one_joint_alone_has_names_it(home: Path, motion: Motion) -> None:
    headers = {2: "Elbow", 0: "Pan", 1: "Lift"}
    columns = {"t [s]": motion.time}
    columns |= {f"{n} Pos [deg]": np.degrees(motion.position[:, i]) for i, n in headers.items()}
    columns |= {f"Cmd {n} [deg]": np.degrees(motion.command[:, i]) for i, n in headers.items()}
    found = lines(written(home / "log.csv", columns))
    for i, command in enumerate(COMMANDS):
        assert found[f"sensor.{JOINTS[i]}_pos"] == (f"{headers[i]} Pos [deg]", "deg", 1)
        assert found[f"ctrl.{command}"] == (f"Cmd {headers[i]} [deg]", "deg", 1)


@pytest.mark.parametrize("named", [(0, 2, 1), (1, 2, 0)], ids=["two", "three"])
@pytest.mark.parametrize("witness", ["commands", "torques"])
def test_states_that_the_torques_tell_to_be_exchanged_are_turned_round(
    home: Path, motion: Motion, named: tuple[int, ...], witness: str
) -> None:
    own = (
        named if witness == "commands" else (0, 1, 2)
    )  # the torques are the states' or the joints'
    columns = {"time": motion.time}
    columns |= {f"{j}_position": motion.position[:, named[i]] for i, j in enumerate(JOINTS)}
    columns |= {f"{j}_effort": motion.torque[:, own[i]] for i, j in enumerate(JOINTS)}
    if witness == "commands":
        columns |= {f"{j}_command": motion.command[:, i] for i, j in enumerate(JOINTS)}
    proposal = propose([written(home / "log.csv", {"time": motion.time, **columns})], MODEL)
    found = {each.column: each.candidate.key.channel for each in proposal.columns if not each.open}
    for i, (joint, command) in enumerate(zip(JOINTS, COMMANDS, strict=True)):
        assert found[f"sensor.{joint}_pos"] == f"{JOINTS[named.index(i)]}_position"
        assert found[f"torque.{joint}"] == f"{JOINTS[own.index(i)]}_effort"
        assert witness == "torques" or found[f"ctrl.{command}"] == f"{joint}_command"
    assert any("are exchanged" in note for note in proposal.notes)


GYRO = ARM.replace(
    '<inertial pos=".1 0 0"', '<site name="tool" euler=".3 .2 0"/><inertial pos=".1 0 0"'
).replace("</sensor>", '<gyro name="imu" site="tool"/></sensor>')
DEG = 180 / np.pi


def turned(motion: Motion) -> np.ndarray:
    """Angular velocity at the tool [rad/s], shape (T, 3)."""
    model = mujoco.MjModel.from_xml_string(GYRO)
    data, read = mujoco.MjData(model), []
    for data.qpos[:], data.qvel[:] in zip(motion.position, motion.velocity, strict=True):
        mujoco.mj_forward(model, data)
        read.append(data.sensor("imu").data.copy())
    return np.array(read)


def guess(home: Path, xml: str, motion: Motion, *blocks: tuple[str, np.ndarray]) -> dict:
    """Lines of a log with three channels for each name, by column."""
    log = {"time": motion.time}
    for names, values in blocks:
        log |= dict(zip(names.split(), values.T, strict=True))
    proposal = propose([written(home / "log.csv", log)], mujoco.MjModel.from_xml_string(xml))
    return {each.column: each for each in proposal.columns if not each.open}


@pytest.mark.parametrize(
    ("factor", "names", "unit", "scale"),
    [
        (1.0, "gx gy gz", "rad/s", 1.0),
        (DEG, "imu_gyrx imu_gyry imu_gyrz", "deg/s", 1.0),
        (131 * DEG, "gyro_0 gyro_1 gyro_2", "rad/s", 1 / 131 / DEG),
        (DEG, "c7 c8 c9", "deg/s", 1.0),  # no name tells them
        (DEG, "wz wx wy", "deg/s", 1.0),  # mounted otherwise
        (DEG, "gx ? gz", "deg/s", 1.0),  # an axis without samples
        (0.0, "gx gy gz", "", 1.0),  # of another body
    ],
)
def test_a_gyro_is_told_by_the_motion(
    home: Path, motion: Motion, factor: float, names: str, unit: str, scale: float
) -> None:
    read = factor * turned(motion) + np.random.default_rng(0).normal(0, 0.02, (len(motion.time), 3))
    read[:, ["?" in name for name in names.split()]] = np.nan
    found = guess(home, GYRO, motion, (POSITIONS, motion.position), (names, read))
    names = names.replace("? ", "")
    tool = [found[c] for axis in "xyz" if (c := f"sensor.imu.{axis}") in found]
    assert [e.candidate.key.channel for e in tool] == sorted(names.split()) * bool(factor)
    assert {each.scaling.unit for each in tool} == {unit} - {""}
    assert all(each.scaling.scale == pytest.approx(scale, rel=0.03) for each in tool)


@pytest.mark.parametrize(
    ("joint", "state", "command"),
    # Both of the pan reversed would be a sensor turned by half a turn as well.
    [(0, -1, 1), (0, 1, -1), (1, -1, 1), (1, -1, -1), (2, 1, -1), (2, -1, -1)],
)
def test_a_gyro_tells_which_of_state_and_command_is_reversed(
    home: Path, motion: Motion, joint: int, state: int, command: int
) -> None:
    signs = np.where(np.arange(3) == joint, [[state], [command]], 1)
    found = guess(home, GYRO, motion, (POSITIONS, signs[0] * motion.position),
                  (ORDERS, signs[1] * motion.command), ("gx gy gz", turned(motion)))  # fmt: skip
    assert [found[f"sensor.{j}_pos"].scaling.sign for j in JOINTS] == signs[0].tolist()
    assert [found[f"ctrl.{c}"].scaling.sign for c in COMMANDS] == signs[1].tolist()


@pytest.mark.parametrize(("unit", "factor"), [("rad", 1.0), ("deg", DEG)])
def test_a_gyro_of_stated_unit_tells_that_of_positions_without_limits(
    home: Path, motion: Motion, unit: str, factor: float
) -> None:
    found = guess(home, GYRO.replace('limited="true"', 'limited="false"'), motion,
                  (POSITIONS, factor * motion.position),
                  ("gx_dps gy_dps gz_dps", DEG * turned(motion)))  # fmt: skip
    assert [found[f"sensor.{j}_pos"].scaling.unit for j in JOINTS] == [unit] * 3


def test_numbers_within_names_make_vectors_beside_channels_of_no_use(
    home: Path, motion: Motion
) -> None:
    rng = np.random.default_rng(0)
    columns = {"seq": np.arange(len(motion.time)), "t_s": motion.time}
    columns |= {"walk": np.cumsum(rng.normal(size=len(motion.time)))}
    for i in range(3):
        columns[f"m{i + 1}_ang"] = motion.position[:, i]
        columns[f"m{i + 1}_spd"] = motion.velocity[:, i]
        columns[f"m{i + 1}_ref"] = motion.command[:, i]
        columns[f"m{i + 1}_err"] = motion.command[:, i] - motion.position[:, i]
    found = lines(written(home / "log.csv", columns))
    for i, (joint, command) in enumerate(zip(JOINTS, COMMANDS, strict=True)):
        assert found[f"sensor.{joint}_pos"][0] == f"m{i + 1}_ang"
        assert found[f"ctrl.{command}"][0] == f"m{i + 1}_ref"


def test_a_wrapped_position_is_put_to_the_turn_of_its_command(home: Path, motion: Motion) -> None:
    turns = np.array([0, 3, -2])
    found = guess(home, ARM.replace('limited="true"', 'limited="false"'), motion,
                  (POSITIONS, DEG * motion.position % 360),
                  (ORDERS.replace("cmd", "cmd_deg"), DEG * motion.command + 360 * turns),
                 )  # fmt: skip
    lines = [found[f"sensor.{joint}_pos"] for joint in JOINTS]
    assert [each.candidate.period for each in lines] == [360] * 3
    for i, each in enumerate(lines):
        (own,) = each.scaling.si(each.candidate.runs)
        np.testing.assert_allclose(own, motion.position[:, i] + 2 * np.pi * turns[i], atol=1e-6)


def test_a_robot_of_which_the_model_has_one_leg(home: Path, motion: Motion) -> None:
    """The other leg moves alike, and its velocities have less noise."""

    def legs(name: str) -> str:
        return " ".join(f"{name}_{k}" for k in range(6))

    noise = np.random.default_rng(0).normal(0, 0.1, motion.velocity.shape)
    found = guess(home, ARM, motion,
                  (legs("dof_pos"), np.hstack([motion.position, motion.position + 0.3])),
                  (legs("dof_vel"), np.hstack([motion.velocity + noise, motion.velocity])),
                 )  # fmt: skip
    for k, joint in enumerate(JOINTS):
        assert found[f"sensor.{joint}_pos"].candidate.key.channel == f"dof_pos_{k}"
        assert found[f"sensor.{joint}_vel"].candidate.key.channel == f"dof_vel_{k}"


def test_words_of_a_servo_are_ticks(home: Path, motion: Motion) -> None:
    def ticks(values: np.ndarray) -> np.ndarray:
        return np.round(values / (2 * np.pi) * 4096 + 2048)

    columns = {"t": motion.time}
    columns |= {f"present_position_{i}": ticks(motion.position[:, i]) for i in range(3)}
    columns |= {f"goal_position_{i}": ticks(motion.command[:, i]) for i in range(3)}
    proposal = propose([written(home / "log.csv", columns)], MODEL)
    found = {each.column: each.scaling for each in proposal.columns if not each.open}
    assert set(found) == ALL
    assert all(each.scale == pytest.approx(2 * np.pi / 4096) for each in found.values())


def test_equal_commands_go_to_the_joints_in_the_order_of_the_file(
    home: Path, motion: Motion
) -> None:
    same = np.repeat(motion.command[:, :1], 3, axis=1)
    follow = np.repeat(motion.position[:, :1], 3, axis=1)
    follow += 5e-4 * np.random.default_rng(0).normal(size=follow.shape)
    found = lines(table(home / "log.csv", motion.time, same, follow))
    assert [found[f"ctrl.{command}"][0] for command in COMMANDS] == ["2", "3", "4"]


def test_torques_with_much_friction_are_told_by_their_whole_vector(
    home: Path, motion: Motion
) -> None:
    dry = np.array([3.0, 3.0, 1.5]) * np.tanh(20 * motion.velocity)
    source = table(home / "log.csv", motion.time, motion.position, motion.velocity,
                   motion.torque + dry)  # fmt: skip
    found = lines(source)
    own = [found[f"torque.{joint}"] for joint in JOINTS]
    assert own == [(channel, "N*m", 1) for channel in ("8", "9", "10")]
