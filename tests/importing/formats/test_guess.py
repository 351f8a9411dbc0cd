"""Proposals find joints, units and signs from signals, and never replace a file unasked."""

from __future__ import annotations

import tomllib
from pathlib import Path

import mujoco
import numpy as np
import pytest

from loose_env.cli.main import main
from loose_env.importing import propose
from loose_env.importing.guessing.channel_names import meaning_of, telling_words
from loose_env.importing.guessing.proposal_text import proposal_text
from loose_env.importing.samples import ChannelKey
from tests.importing.formats.arm_log import ARM, JOINTS, Motion, write_lerobot, write_rtde

MODEL = mujoco.MjModel.from_xml_string(ARM)


def table(path: Path, *columns: np.ndarray) -> str:
    np.savetxt(path, np.hstack([np.reshape(c, (len(c), -1)) for c in columns]), delimiter=",",
               fmt="%.10g")  # fmt: skip
    return str(path)


def lines(source: str, rate_hz: float | None = None) -> dict[str, tuple[str, str, int]]:
    """Channel, unit and sign of each column that is proposed."""
    return {
        each.column: (each.candidate.key.channel, each.scaling.unit, each.sign)
        for each in propose([source], MODEL, rate_hz).columns
        if not each.open
    }


def test_degrees_reversed_rates_and_shuffled_commands_of_a_nameless_table(
    home: Path, motion: Motion
) -> None:
    order = [2, 0, 1]
    source = table(home / "log.csv", 1e3 * motion.time, np.degrees(motion.position),
                   -np.degrees(motion.velocity), np.degrees(motion.command)[:, order])  # fmt: skip
    found = lines(source)
    for i, (joint, command) in enumerate(zip(JOINTS, ("pan", "lift", "bend"), strict=True)):
        assert found[f"sensor.{joint}_pos"] == (str(2 + i), "deg", 1)
        assert found[f"sensor.{joint}_vel"] == (str(5 + i), "deg/s", -1)
        assert found[f"ctrl.{command}"] == (str(8 + order.index(i)), "deg", 1)


def test_a_reversed_command_gets_its_sign(home: Path, motion: Motion) -> None:
    command = motion.command * [1, -1, 1]
    source = table(home / "log.csv", motion.time, motion.position, motion.velocity, command)
    found = lines(source)
    assert found["ctrl.lift"][1:] == ("rad", -1)
    assert found["ctrl.pan"][1:] == ("rad", 1)


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
    columns = (("shoulder_pan_pos", "pan"), ("shoulder_lift_pos", "lift"), ("elbow_pos", "bend"))
    for i, (position, command) in enumerate(columns):
        for column in (f"sensor.{position}", f"ctrl.{command}"):
            assert found[column].scaling.scale == pytest.approx(half[i] / 100)
            assert found[column].scaling.unit == "rad"
    assert "normalised to -100..100 of the limits" in found["sensor.elbow_pos"].reason


def test_degrees_that_may_be_normalised_are_noted(home: Path, motion: Motion) -> None:
    proposal = propose([str(write_lerobot(home / "set", motion))], MODEL)
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
    assert [channel.key.channel for _, channel in proposal.unassigned] == ["Druck [V]"]
    text = proposal_text(proposal, "arm.xml")
    assert '# "sensor.?" = { channel = "Druck [V]", unit = "V" }' in text.splitlines()


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
    assert [c.key.channel for _, c in proposal.unassigned] == ["shoulder_lift_pos [g]"]


@pytest.mark.parametrize(
    ("channel", "role", "of", "index"),
    [
        ("actual_q_0", "position", "position", 0),
        ("target_qd_3", "command", "velocity", 3),
        ("target_TCP_pose_1", "other", "other", 1),
        ("actual_current_as_torque_2", "torque", "torque", 2),
        ("observation.state[elbow.pos]", "position", "position", None),
        ("action[2]", "command", "command", 2),
        ("obs/robot0_joint_pos_cos[1]", "other", "other", 1),
        ("elbow [deg]", "", "", None),
        ("7", "", "", None),
    ],
)
def test_names_tell_the_quantity(channel: str, role: str, of: str, index: int | None) -> None:
    found = meaning_of(ChannelKey(channel))
    assert (found.role, found.index) == (role, index)
    if role == "command":
        assert found.of == of


def test_a_word_that_one_joint_alone_has_names_it(home: Path, motion: Motion) -> None:
    headers = {2: "Elbow", 0: "Pan", 1: "Lift"}
    columns = {"t [s]": motion.time}
    columns |= {f"{n} Pos [deg]": np.degrees(motion.position[:, i]) for i, n in headers.items()}
    columns |= {f"Cmd {n} [deg]": np.degrees(motion.command[:, i]) for i, n in headers.items()}
    found = lines(written(home / "log.csv", columns))
    for i, command in enumerate(("pan", "lift", "bend")):
        assert found[f"sensor.{JOINTS[i]}_pos"] == (f"{headers[i]} Pos [deg]", "deg", 1)
        assert found[f"ctrl.{command}"] == (f"Cmd {headers[i]} [deg]", "deg", 1)


def test_a_word_of_two_joints_names_neither() -> None:
    assert telling_words(JOINTS) == {"pan": JOINTS[0], "lift": JOINTS[1], "elbow": "elbow"}
