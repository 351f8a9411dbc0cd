"""What ``loose import --describe`` prints is a mapping, once its lines are filled in."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import mujoco
import numpy as np
import pytest

from loose_env.cli.main import main
from loose_env.importing import describe_sources, import_recording, read_mapping
from loose_env.importing.readers.csv_list import list_csv
from tests.importing.sample_files import ARM, motion, write_csv, write_robot, write_uff


def filled(text: str, columns: dict[str, str]) -> str:
    """Take the mark off lines, as a user would: a piece of the line -> the column."""
    lines = text.splitlines()
    for piece, column in columns.items():
        (i,) = (i for i, line in enumerate(lines) if piece in line and line.startswith('# "'))
        lines[i] = re.sub(r'^# "[^"]*"', f'"{column}"', lines[i])
    return "\n".join(lines).replace('model = "model.xml"', 'model = "arm.xml"')


def test_a_mapping_filled_in_makes_a_recording(
    home: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    time = np.arange(600) / 1000
    signals = motion(time)
    bag = write_robot(home / "robot.mcap", seconds=1.0)
    table = write_csv(
        home / "my log (3).csv",
        np.stack([time * 1e3, np.degrees(signals["shoulder"]), signals["rate"]], 1),
        ["Time [ms]", "angle (deg)", "rate"],
        separator="\t",
        decimal=",",
        before=["made by a logger", "", "Serial\t12"],
    )
    axes = {(1, 1): signals["x"], (1, -2): signals["y"], (1, 3): signals["z"]}
    vibration = write_uff(home / "v.uff", time, axes, unit="m/s2")
    files = [str(bag), str(table), str(vibration)]
    assert main(["import", "--describe", *files]) == 0
    text = capsys.readouterr().out
    tomllib.loads(text)
    assert "200 Hz over 0.995 s, from 2024-05-01T10:00:00" in text
    columns = {
        '"angle (deg)"': "sensor.shoulder_angle",
        '"rate"': "sensor.shoulder_rate",
        '"1+X"': "sensor.tool.x",
        '"1-Y"': "sensor.tool.y",
        '"1+Z"': "sensor.tool.z",
        '"position[elbow]"': "sensor.elbow_angle",
    }
    text = filled(text, columns).replace(
        'kind = "mcap"', 'kind = "mcap"\ntime = { from_start = true }'
    )
    (home / "map.toml").write_text(text)
    found = import_recording(files, home / "map.toml", home / "out").runs[0]
    np.testing.assert_allclose(found.sensors["shoulder_angle"], signals["shoulder"], atol=1e-9)
    np.testing.assert_allclose(found.sensors["tool"][:, 1], -signals["y"], atol=1e-9)
    assert found.samples == 600


def test_with_the_model_names_find_their_columns(home: Path) -> None:
    bag = write_robot(home / "robot.mcap")
    text = describe_sources([str(bag)], mujoco.MjModel.from_xml_string(ARM))
    assert '#   "sensor.tool.x"  acceleration' in text
    for start in ('# "sensor.elbow_angle" = {', '# "sensor.shoulder_rate" = {'):
        assert start in text
        text = text.replace(start, start[2:])
    (home / "map.toml").write_text(text.replace("model.xml", "arm.xml"))
    assert len(read_mapping(home / "map.toml").runs[0].columns) == 2
    found = import_recording([bag], home / "map.toml", home / "out").runs[0]
    np.testing.assert_array_equal(
        found.sensors["elbow_angle"], motion(np.arange(400) / 200)["elbow"]
    )


@pytest.mark.parametrize(
    ("text", "options", "names"),
    [
        ("a,b\n1,2\n3,4\n", (), ["a", "b"]),
        ("a;b\n1,5;2\n3,5;4\n", ('separator = ";"', 'decimal = ","'), ["a", "b"]),
        ("1 2\n3 4\n", ('separator = " "', "header = false"), ["1", "2"]),
        (
            "# Logger\n\nt|a\n[s]|[g]\n0|1\n1|2\n",
            ('separator = "|"', "skip = 2", "skip_after_header = 1"),
            ["t", "a"],
        ),
        ("time,a,a\n0,1,2\n1,2,3\n", (), ["time", "#2", "#3"]),
        ('"Logger" version 5\nt,a\n0,1\n1,2\n', ("skip = 1",), ["t", "a"]),
        ('"not closed\nt,a\n0,1\n1,2\n', ("skip = 1",), ["t", "a"]),
    ],
)
def test_tables_are_recognised(
    tmp_path: Path, text: str, options: tuple[str, ...], names: list[str]
) -> None:
    path = tmp_path / "log.csv"
    path.write_text(text)
    found = list_csv(path, "log.csv")
    assert found.options[:-1] == options
    assert [each.key.channel for each in found.streams[0].channels] == names


def test_files_of_one_stem_are_all_listed(tmp_path: Path) -> None:
    for name in ("daq.csv", "daq.txt"):
        (tmp_path / name).write_text("t,a\n0,1\n1,2\n2,3\n")
    text = describe_sources([str(tmp_path / name) for name in ("daq.csv", "daq.txt")])
    tomllib.loads(text)
    assert "[sources.daq]" in text
    assert "[sources.daq-2]" in text
