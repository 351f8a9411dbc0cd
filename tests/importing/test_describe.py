"""What ``loose import --describe`` prints is a mapping, once its lines are filled in."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest

from loose_env.cli.main import main
from loose_env.errors import InvalidData
from loose_env.importing import describe_sources, import_recording, list_sources, read_mapping
from tests.importing.sample_files import ARM, motion, write_csv, write_robot

Mapped = Callable[[str], Path]


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
    rows = np.stack([time, *(signals[axis] for axis in "xyz")], 1)
    vibration = write_csv(home / "v.csv", rows, ["time", *(f"a{axis} [m/s2]" for axis in "xyz")])
    files = [str(bag), str(table), str(vibration)]
    assert main(["import", "--describe", *files]) == 0
    text = capsys.readouterr().out
    tomllib.loads(text)
    assert "200 Hz over 0.995 s, from 2024-05-01T10:00:00" in text
    columns = {
        '"angle (deg)"': "sensor.shoulder_angle",
        '"rate"': "sensor.shoulder_rate",
        '"ax [m/s2]"': "sensor.tool.x",
        '"ay [m/s2]"': "sensor.tool.y",
        '"az [m/s2]"': "sensor.tool.z",
        '"position[elbow]"': "sensor.elbow_angle",
    }
    text = filled(text, columns).replace(
        'kind = "mcap"', 'kind = "mcap"\ntime = { from_start = true }'
    )
    (home / "map.toml").write_text(text)
    found = import_recording(files, home / "map.toml", home / "out").runs[0]
    np.testing.assert_allclose(found.sensors["shoulder_angle"], signals["shoulder"], atol=1e-9)
    np.testing.assert_allclose(found.sensors["tool"][:, 1], signals["y"], atol=1e-9)
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
    (found,) = list_sources([str(path)]).values()
    assert tuple(found.lines[1:-1]) == options
    assert list(found.streams[0].channels) == names


def test_files_of_one_stem_are_all_listed(tmp_path: Path) -> None:
    for name in ("daq.csv", "daq.txt"):
        (tmp_path / name).write_text("t,a\n0,1\n1,2\n2,3\n")
    text = describe_sources([str(tmp_path / name) for name in ("daq.csv", "daq.txt")])
    tomllib.loads(text)
    assert "[sources.daq]" in text
    assert "[sources.daq-2]" in text


# ------------------------------------------------------------------------- dates

COLUMN = '[columns]\n"sensor.elbow_angle" = { channel = "q" }\n[[runs]]\n'


def table(path: Path, stamps: list[str]) -> Path:
    lines = ["Time;q", *(f"{stamp};{0.01 * i:.3f}" for i, stamp in enumerate(stamps))]
    path.write_text("\n".join(lines) + "\n")
    return path


def stamps(date: str) -> list[str]:
    """200 Hz over half a second, across a full second."""
    return [f"{date} 10:11:{12 + (i * 5) // 1000:02d}.{i * 5 % 1000:03d}" for i in range(180, 280)]


@pytest.mark.parametrize(
    ("cells", "expected"),
    [
        (["04.03.2025 10:11:12.345"], "%d.%m.%Y %H:%M:%S.%f"),
        (["04.03.25 10:11:12"], "%d.%m.%y %H:%M:%S"),
        (["13/03/2025 10:11:12"], "%d/%m/%Y %H:%M:%S"),
        (["03/13/2025 10:11:12.5 AM"], "%m/%d/%Y %I:%M:%S.%f %p"),
        (["04/03/2025 23:59:59", "05/03/2025 00:00:00"], "%d/%m/%Y %H:%M:%S"),
        (["04/03/2025 23:59:59", "04/04/2025 00:00:00"], "%m/%d/%Y %H:%M:%S"),
        (["2025/03/04 10:11:12,345"], "%Y/%m/%d %H:%M:%S,%f"),
        (["2025-03-04T10:11:12.345Z"], "iso"),
    ],
)
def test_the_order_of_day_and_month_follows_from_the_data(
    tmp_path: Path, cells: list[str], expected: str
) -> None:
    said = describe_sources([str(table(tmp_path / "log.csv", cells * 2))])
    assert tomllib.loads(said)["sources"]["log"]["time"]["date_format"] == expected


def test_a_table_with_german_dates_keeps_its_rate(home: Path, mapping: Mapped) -> None:
    log = table(home / "log.csv", stamps("04.03.2025"))
    mapped = mapping(f'[sources.log]\nseparator = ";"\ntime = {{ column = "Time" }}\n{COLUMN}')
    run = import_recording([log], mapped, home / "out").runs[0]
    np.testing.assert_allclose(np.diff(run.time), 0.005, atol=1e-9)
    assert 'date_format = "%d.%m.%Y %H:%M:%S.%f"' in describe_sources([str(log)])


def test_an_ambiguous_table_is_refused_until_the_format_is_stated(
    home: Path, mapping: Mapped
) -> None:
    log = table(home / "log.csv", stamps("04/03/2025"))
    source = '[sources.log]\nseparator = ";"\ntime = { column = "Time"'
    with pytest.raises(InvalidData, match="give date_format"):
        import_recording([log], mapping(f"{source} }}\n{COLUMN}"), home / "out")
    stated = mapping(f'{source}, date_format = "%m/%d/%Y %H:%M:%S.%f" }}\n{COLUMN}')
    assert import_recording([log], stated, home / "out").runs[0].samples == 100
    said = describe_sources([str(log)])
    tomllib.loads(said)
    assert "give date_format" in said


def test_no_rate_is_assumed_where_a_table_has_no_time(home: Path, mapping: Mapped) -> None:
    log = home / "log.csv"
    log.write_text("p,q\n" + "".join(f"{i},{i * 0.1}\n" for i in range(50)))
    said = describe_sources([str(log)])
    assert "time" not in tomllib.loads(said)["sources"]["log"]
    assert "no column of time was found" in said
    with pytest.raises(InvalidData, match="no rate is assumed"):
        import_recording([log], mapping(f"[sources.log]\n{COLUMN}"), home / "out")
