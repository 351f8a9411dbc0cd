"""A known motion, written by loggers' own libraries, comes back as a recording."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType

from loose_env.cli.main import main
from loose_env.errors import InvalidSetting
from loose_env.importing import ImportSettings, import_recording
from loose_env.recording import Run, read_recording, write_recording
from tests.importing.sample_files import (
    ARM,
    START_NS,
    motion,
    write_csv,
    write_robot,
)

Mapped = Callable[..., Path]

ROBOT = """
[sources.robot]
[columns]
"sensor.shoulder_angle" = { topic = "/joint_states", channel = "position[shoulder]" }
"sensor.elbow_angle" = { topic = "/joint_states", channel = "position[elbow]" }
"sensor.shoulder_rate" = { topic = "/joint_states", channel = "velocity[shoulder]" }
"sensor.tool.x" = { topic = "/imu", channel = "linear_acceleration.x" }
"sensor.tool.y" = { topic = "/imu", channel = "linear_acceleration.y" }
"sensor.tool.z" = { topic = "/imu", channel = "linear_acceleration.z" }
"ctrl.lift" = { topic = "/commands", channel = "data[0]" }
[[runs]]
file = "swing"
excited = ["shoulder"]
pose = { shoulder = 0.5, elbow = -0.2 }
condition = "healthy"
"""


def known(time: np.ndarray) -> dict[str, np.ndarray]:
    signals = motion(time)
    return {
        "shoulder_angle": signals["shoulder"],
        "elbow_angle": signals["elbow"],
        "shoulder_rate": signals["rate"],
        "tool": np.stack([signals[axis] for axis in "xyz"], axis=1),
    }


@pytest.mark.parametrize("compression", list(CompressionType))
def test_a_bag_of_ros2_comes_back_to_the_last_bit(
    home: Path, mapping: Mapped, compression: CompressionType
) -> None:
    bag = write_robot(home / "robot.mcap", compression=compression)
    found = import_recording([bag], mapping(ROBOT), home / "out")
    time = np.arange(400) / 200
    whole = known(time)
    direct = write_recording(
        home / "direct",
        model_xml=ARM,
        runs=[
            Run(
                name="swing",
                time=time,
                sensors=whole,
                controls={"lift": motion(time)["lift"]},
                excited=("shoulder",),
                pose={"shoulder": 0.5, "elbow": -0.2},
                condition="healthy",
            )
        ],
    )
    one, other = found.runs[0], direct.runs[0]
    np.testing.assert_allclose(one.time, other.time, atol=2e-9)
    for name, values in other.sensors.items():
        np.testing.assert_array_equal(one.sensors[name], values)
    np.testing.assert_array_equal(one.controls["lift"], other.controls["lift"])
    assert (one.excited, one.condition, one.name) == (other.excited, "healthy", other.name)
    assert one.pose == pytest.approx(other.pose)
    assert read_recording(home / "out").model().nu == 2


def test_the_command_line_writes_what_the_gap_reads(
    home: Path, mapping: Mapped, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = write_robot(home / "robot.mcap")
    told = ["import", str(bag), "--mapping", str(mapping(ROBOT)), "--out", str(home / "out")]
    assert main(told) == 0
    said = capsys.readouterr()
    assert "written:" in said.out
    assert "400 rows, 1.995 s at 200 Hz" in said.err
    recording = read_recording(home / "out")
    assert recording.runs[0].comparison == "forward"
    assert main(told) == 1
    assert "is not empty" in capsys.readouterr().err
    assert main([*told, "--overwrite", "--file-format", "csv", "--quiet"]) == 0
    assert capsys.readouterr().err == ""
    assert (home / "out" / "swing.csv").is_file()


def test_a_table_with_commas_units_and_lines_of_words(home: Path, mapping: Mapped) -> None:
    time = np.arange(500) / 1000
    signals = motion(time)
    rows = np.stack(
        [1e3 * time, signals["x"] / 9.80665e-3, np.degrees(signals["shoulder"]), signals["rate"]], 1
    )
    write_csv(
        home / "daq.csv",
        rows,
        ["Zeit [ms]", "ax", "Winkel", "rpm"],
        separator=";",
        decimal=",",
        before=['"Logger" 5', "Serial; 12"],
        after=["ms;mg;deg;1/min"],
        encoding="latin-1",
    )
    mapped = mapping(
        """
[sources.daq]
file = "daq.csv"
time = { column = "Zeit [ms]", unit = "ms" }
[columns]
"sensor.shoulder_angle" = { channel = "Winkel", unit = "deg", sign = -1, offset = 0.25 }
"sensor.shoulder_rate" = { channel = "rpm", unit = "rpm" }
"torque.elbow" = { channel = "ax", unit = "N·m", scale = 0.001 }
[[runs]]
"""
    )
    found = import_recording([home / "daq.csv"], mapped, home / "out").runs[0]
    np.testing.assert_allclose(found.time, time, atol=1e-12)
    np.testing.assert_allclose(
        found.sensors["shoulder_angle"], 0.25 - signals["shoulder"], atol=1e-10
    )
    np.testing.assert_allclose(
        found.sensors["shoulder_rate"], signals["rate"] * 2 * np.pi / 60, atol=1e-9
    )
    np.testing.assert_allclose(found.torques["elbow"], signals["x"] / 9.80665, atol=1e-9)


@pytest.mark.parametrize(
    ("stamp", "clock"),
    [
        (lambda ns: str(ns), 'unit = "ns"'),
        (lambda ns: str(ns // 1000), 'unit = "us"'),
        (lambda ns: f"{ns // 10**9}.{ns % 10**9:09d}", 'unit = "s"'),
        (
            lambda ns: f"2024-05-01T10:00:{ns // 10**9 % 60:02d}.{ns % 10**9:09d}+00:00",
            'unit = "ns"',
        ),
        (
            lambda ns: f"01.05.2024 10:00:{ns // 10**9 % 60:02d}.{ns // 1000 % 10**6:06d}",
            'unit = "ns"',
        ),
    ],
    ids=["ns", "us", "seconds", "iso", "strptime"],
)
def test_dates_in_a_table_keep_their_microseconds(
    home: Path, mapping: Mapped, stamp: Callable[[int], str], clock: str
) -> None:
    time = np.arange(100) / 1000
    stamps = [START_NS + round(t * 1e9) for t in time]
    lines = ["t,q", *(f"{stamp(ns)},{i}" for i, ns in enumerate(stamps))]
    (home / "log.csv").write_text("\n".join(lines))
    mapped = mapping(
        f'[sources.log]\ntime = {{ column = "t", {clock} }}\n[columns]\n'
        '"sensor.elbow_angle" = { channel = "q" }\n[[runs]]\nstart = 0.02\n'
    )
    found = import_recording([home / "log.csv"], mapped, home / "out").runs[0]
    assert found.sensors["elbow_angle"][0] == 20
    np.testing.assert_allclose(found.time, time[:80], atol=3e-7)


def test_a_counter_that_overflows_is_counted_on(home: Path, mapping: Mapped) -> None:
    stamps = (60_000 + 20 * np.arange(400)) % 2**16
    (home / "log.csv").write_text("\n".join(["t,q", *(f"{t},{i}" for i, t in enumerate(stamps))]))
    mapped = mapping(
        '[sources.log]\ntime = { column = "t", unit = "ms" }\n[columns]\n'
        '"sensor.elbow_angle" = { channel = "q" }\n[[runs]]\n'
    )
    said: list[str] = []
    found = import_recording([home / "log.csv"], mapped, home / "out", say=said.append).runs[0]
    assert "the counter 't' [ms] overflows at 65536, from 65520.0 to 4.0" in said[0]
    np.testing.assert_allclose(found.time, np.arange(400) * 0.02, atol=1e-9)
    np.testing.assert_array_equal(found.sensors["elbow_angle"], np.arange(400))


def test_sources_of_different_rates_and_clocks_are_joined(home: Path, mapping: Mapped) -> None:
    write_robot(home / "robot.mcap", seconds=6.0)
    # The recorder starts 1 s after the robot, and its clock counts from its own start.
    time = np.arange(4000) / 1000
    signals = motion(time + 1.0)
    rows = np.stack([time, signals["shoulder"], signals["elbow"]], 1)
    write_csv(home / "v.csv", rows, ["t", "a", "b"])
    mapped = mapping(
        """
[sources.robot]
time = { from_start = true }
[sources.v]
time = { column = "t", offset_s = 1.0 }
[[runs]]
[columns]
"sensor.elbow_angle" = { source = "v", channel = "b", unit = "rad" }
[columns."sensor.shoulder_angle"]
source = "robot"
topic = "/joint_states"
channel = "position[shoulder]"
"""
    )
    said: list[str] = []
    found = import_recording(
        [f"robot={home / 'robot.mcap'}", home / "v.csv"], mapped, home / "out", say=said.append
    ).runs[0]
    assert "sensor.shoulder_angle: spline of degree 7 from 200 Hz" in "\n".join(said)
    inner = slice(200, -200)
    true = motion(found.time + 1.0)
    assert found.samples == 4000
    for sensor, signal in (("elbow_angle", "elbow"), ("shoulder_angle", "shoulder")):
        assert np.abs(found.sensors[sensor] - true[signal])[inner].max() < 1e-2


def test_many_runs_take_their_files_in_turn(home: Path, mapping: Mapped) -> None:
    time = np.arange(50) / 100
    files = []
    for i in range(3):
        rows = np.stack([time, np.full(50, float(i)), time * i], 1)
        files.append(write_csv(home / f"pose-{i}.csv", rows, ["t", "q", "a"]))
    runs = "".join(
        f'[[runs]]\nfile = "run-{i}"\npose = {{ elbow = {i}.0 }}\n'
        f'sources = {{ log = "pose-{i}.csv" }}\n'
        for i in range(3)
    )
    mapped = mapping(
        '[sources.log]\ntime = { column = "t" }\n[columns]\n"sensor.elbow_angle" = '
        f'{{ channel = "q" }}\n{runs}'
    )
    found = import_recording(files, mapped, home / "out")
    assert [run.pose for run in found.runs] == [{"elbow": 0.0}, {"elbow": 1.0}, {"elbow": 2.0}]


def test_a_gap_stays_a_gap(home: Path, mapping: Mapped) -> None:
    time = np.arange(1000) / 1000
    fast = write_csv(home / "fast.csv", np.stack([time, time], 1), ["t", "q"])
    slow_time = np.arange(100) / 100
    kept = (slow_time < 0.4) | (slow_time > 0.45)
    rows = np.stack([slow_time, np.sin(slow_time)], 1)[kept]
    slow = write_csv(home / "slow.csv", rows, ["t", "w"])
    mapped = mapping(
        """
[sources.fast]
time = { column = "t" }
[sources.slow]
time = { column = "t" }
[[runs]]
[columns]
"sensor.elbow_angle" = { source = "fast", channel = "q" }
"sensor.shoulder_rate" = { source = "slow", channel = "w" }
"""
    )
    run = import_recording([f"fast={fast}", f"slow={slow}"], mapped, home / "out").runs[0]
    missing = np.isnan(run.sensors["shoulder_rate"])
    np.testing.assert_array_equal(missing, (run.time > 0.3905) & (run.time < 0.4595))
    assert not np.isnan(run.sensors["elbow_angle"]).any()


def test_commands_are_held_no_longer_than_their_gaps(home: Path, mapping: Mapped) -> None:
    time = np.arange(400) / 100
    log = write_csv(home / "log.csv", np.stack([time, np.sin(time)], 1), ["t", "a"])
    steps = write_csv(home / "steps.csv", np.array([[0, 1], [1, 2], [2, 3], [4, 4]]), ["t", "u"])
    clock = 'time = { column = "t" }'
    mapped = mapping(
        f"[sources.log]\n{clock}\n[sources.steps]\n{clock}\n[columns]\n"
        '"sensor.elbow_angle" = { source = "log", channel = "a" }\n'
        '"ctrl.lift" = { source = "steps", channel = "u" }\n[[runs]]\nstop = 3\n'
    )
    run = import_recording([log, steps], mapped, home / "out").runs[0]
    np.testing.assert_array_equal(run.sensors["elbow_angle"], np.sin(time).round(9)[:301])
    np.testing.assert_array_equal(run.controls["lift"][[0, 99, 100, 199, 200]], [1, 1, 2, 2, 3])


URDF = """
<robot name="one"><link name="base"/><link name="arm"><inertial><origin xyz="0 0 0.1"/>
<mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
</link><joint name="lift" type="revolute">
<parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" effort="20" velocity="3"/></joint></robot>
"""


def test_a_urdf_is_guessed_and_imported_with_the_columns_of_its_joints(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(URDF, encoding="utf-8")
    time = np.arange(0, 4, 0.01)
    angle = 0.3 * np.sin(2 * time)
    torque = 0.02 * -4 * angle - 0.981 * np.sin(angle)
    rows = np.column_stack([time, angle, torque])
    header = "time,lift,effort_lift"
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header=header, comments="")
    log, mapped = str(tmp_path / "log.csv"), str(tmp_path / "map.toml")
    model = ["--model", str(tmp_path / "arm.urdf")]
    assert main(["import", "--guess", log, *model, "--mapping", mapped]) == 0
    assert main(["import", log, *model, "--mapping", mapped, "--out", str(tmp_path / "rec")]) == 0
    (run,) = read_recording(tmp_path / "rec").runs
    assert run.sensors["lift_pos"] == pytest.approx(angle, abs=1e-9)
    assert run.torques["lift"] == pytest.approx(torque, abs=1e-9)


SENSED = """<mujoco><worldbody><body><joint name="lift" axis="0 1 0" range="-2 2"/>
<geom size=".1" mass="1" pos=".2 0 0"/><site name="tip" pos=".4 0 0"/></body></worldbody>
<sensor><jointpos name="lift_pos" joint="lift"/><accelerometer name="tool" site="tip"/></sensor>
</mujoco>"""


@pytest.mark.parametrize(("gravity", "unit"), [(9.81, "m/s^2"), (1.0, "g"), (0.0, "")])
def test_an_accelerometer_that_its_file_names_is_told_by_gravity(
    tmp_path: Path, gravity: float, unit: str
) -> None:
    (tmp_path / "arm.xml").write_text(SENSED)
    for run in "12":
        time, fine = np.arange(0, 4, 0.01), np.arange(0, 4, 0.002)
        angle = np.column_stack([time, 0.3 * np.sin(5 * time + int(run))])
        noise = np.random.default_rng(int(run)).normal(0, 0.01, (3, len(fine)))
        shaken = np.outer([1.4 * gravity, 0, 0], np.sin(2 * np.pi * 5 * fine))
        tool = np.column_stack([1e3 * fine, *(noise + shaken + [[0.0], [0.1], [gravity]])])
        write_csv(tmp_path / f"robot-{run}.csv", angle, ["t", "q_lift"])
        write_csv(tmp_path / f"acc-{run}.csv", tool, ["t_ms", "ax", "ay", "az"])
    logs = [str(tmp_path / f"{kind}-{run}.csv") for kind in ("robot", "acc") for run in "12"]
    words = ["--model", str(tmp_path / "arm.xml"), "--mapping", str(tmp_path / "map.toml")]
    assert main(["import", "--guess", *logs, *words]) == 0
    said = (tmp_path / "map.toml").read_text()
    for axis in "xyz":
        column = f'"sensor.tool.{axis}" = {{ source = "acc-1", channel = "a{axis}", unit = "{unit}"'
        assert (column in said) == bool(unit)
    assert ('file = "run-01"' in said and 'file = "run-02"' in said) or not unit


def test_a_row_without_a_time_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "arm.xml").write_text(SENSED)
    time = np.arange(0, 4, 0.01)
    rows = np.column_stack([time, np.sin(5 * time)])
    rows[3, 0] = np.nan
    write_csv(tmp_path / "robot.csv", rows, ["t", "q_lift"])
    words = ["--model", str(tmp_path / "arm.xml"), "--mapping", str(tmp_path / "map.toml")]
    assert main(["import", "--guess", str(tmp_path / "robot.csv"), *words]) == 1
    assert "line 5, column 't': '' is no time" in capsys.readouterr().err
    assert not (tmp_path / "map.toml").exists()


PLANNED = """{"format": "loose-recording/1", "model": "arm.xml", "runs": [
 {"file": "run-01.csv", "pose": {"elbow": 0.25}, "planned": true},
 {"file": "run-02.csv", "condition": "healthy", "planned": true},
 {"file": "run-03.csv", "planned": true}]}"""


def planned(home: Path) -> Path:
    """A recording to be filled, with a file of the plan that the recording does not name."""
    folder = home / "session"
    folder.mkdir()
    folder.joinpath("arm.xml").write_text(ARM)
    folder.joinpath("plan.json").write_text("{}")
    folder.joinpath("recording.json").write_text(PLANNED)
    return folder


def elbow(home: Path, mapping: Mapped, *runs: str) -> Path:
    """Mapping of an elbow's log into runs of the given names."""
    named = "\n".join(f'[[runs]]\nfile = "{each}"' for each in runs)
    time = np.arange(400) / 200
    degrees = np.degrees(motion(time)["elbow"])
    write_csv(home / "log.csv", np.stack([time, degrees], 1), ["t", "encoder"])
    return mapping(
        f"""
[sources.log]
file = "log.csv"
time = {{ column = "t" }}
[columns]
"sensor.elbow_angle" = {{ channel = "encoder", unit = "deg" }}
{named}
"""
    )


def test_runs_go_into_the_recording_of_a_plan(home: Path, mapping: Mapped) -> None:
    folder = planned(home)
    before = folder.joinpath("recording.json").read_text()
    map_file = elbow(home, mapping, "run-01", "run-02.csv")
    code = main(["import", str(home / "log.csv"), "--mapping", str(map_file), "--out", str(folder)])
    assert code == 0
    first, second = read_recording(folder).runs
    assert (first.name, first.pose, first.condition) == ("run-01.csv", {"elbow": 0.25}, "suspect")
    assert (second.name, second.pose, second.condition) == ("run-02.csv", None, "healthy")
    assert folder.joinpath("recording.json").read_text() == before
    names = {each.name for each in home.joinpath("session").iterdir()}
    assert names == {"arm.xml", "plan.json", "recording.json", "run-01.csv", "run-02.csv"}
    third = elbow(home, mapping, "run-03")
    assert len(import_recording([home / "log.csv"], third, folder).runs) == 3


@pytest.mark.parametrize(
    ("runs", "says"),
    [
        (("run-01", "run-09"), "'run-09' is not in the plan"),
        (('run-01"\ncondition = "healthy',), "plans it as suspect"),
    ],
)
def test_runs_that_a_plan_has_not_change_nothing(
    home: Path, mapping: Mapped, runs: tuple[str, ...], says: str
) -> None:
    folder = planned(home)
    with pytest.raises(InvalidSetting, match=says):
        import_recording([home / "log.csv"], elbow(home, mapping, *runs), folder)
    assert not list(folder.glob("run-*"))


def test_a_measured_run_is_replaced_only_where_asked(home: Path, mapping: Mapped) -> None:
    folder, map_file = planned(home), elbow(home, mapping, "run-01")
    import_recording([home / "log.csv"], map_file, folder)
    with pytest.raises(InvalidSetting, match="measured already"):
        import_recording([home / "log.csv"], map_file, folder)
    again = ImportSettings(overwrite=True)
    assert len(import_recording([home / "log.csv"], map_file, folder, again).runs) == 1
    with pytest.raises(InvalidSetting, match="a model of its own"):
        import_recording([home / "log.csv"], map_file, folder, again, model=home / "arm.xml")
