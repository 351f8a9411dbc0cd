"""Tables are recognised as they are; channels that no evidence tells are lines to fill in."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from loose_env.cli.main import main
from loose_env.importing import import_recording
from loose_env.importing.sources import open_log
from tests.importing.sample_files import motion, write_csv

Mapped = Callable[[str], Path]


def test_a_proposal_that_knows_no_channel_is_filled_in_by_hand(
    home: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    time = np.arange(600) / 1000
    signals = motion(time)
    write_csv(
        home / "my log (3).csv",
        np.stack([time * 1e3, signals["shoulder"], signals["elbow"]], 1),
        ["Time [ms]", "p (V)", "q (V)"],
        separator="\t",
        decimal=",",
        before=["made by a logger", "", "Serial\t12"],
    )
    told = ["import", str(home / "my log (3).csv"), "--mapping", str(home / "map.toml")]
    assert main([*told, "--guess", "--model", str(home / "arm.xml")]) == 1
    assert "map.toml lists all channels" in capsys.readouterr().err
    text = (home / "map.toml").read_text()
    assert tomllib.loads(text)["sources"]["my-log--3"]["time"]["unit"] == "ms"
    lines = text.splitlines()
    (i,) = (i for i, line in enumerate(lines) if '"q (V)"' in line)
    lines[i] = re.sub(r'^# "[^"]*"', '"sensor.elbow_angle"', lines[i]).replace('V"', 'rad"')
    (home / "map.toml").write_text("\n".join(lines))
    assert main([*told, "--out", str(home / "out")]) == 0
    found = import_recording(told[1:2], home / "map.toml", home / "again").runs[0]
    np.testing.assert_allclose(found.sensors["elbow_angle"], signals["elbow"], atol=1e-9)
    assert found.samples == 600


@pytest.mark.parametrize(
    ("text", "columns"),
    [
        ("a,b\n1,2\n3,4\n", {"a": [1, 3], "b": [2, 4]}),
        ("a;b\n1,5;2\n3,5;4\n", {"a": [1.5, 3.5], "b": [2, 4]}),
        ('"a","b"\n"1,5","2"\n"3,5","4"\n', {"a": [1.5, 3.5], "b": [2, 4]}),
        ("1 2\n3 4\n", {"1": [1, 3], "2": [2, 4]}),
        ("  1   2 \n  3   4 \n", {"1": [1, 3], "2": [2, 4]}),
        ("# Logger\n\nt|a\n[s]|[g]\n0|1\n1|2\n", {"t": [0, 1], "a": [1, 2]}),
        ("time,a,a\n0,1,2\n1,2,3\n", {"time": [0, 1], "#2": [1, 2], "#3": [2, 3]}),
        ("# log; 3 axes\n# of N.N., slow\n# t a b c\n0 1 2 3\n1 2 3 4\n",
         {"t": [0, 1], "a": [1, 2], "b": [2, 3], "c": [3, 4]}),
        ('"Logger" version 5\nt,a\n0,1\n1,2\n', {"t": [0, 1], "a": [1, 2]}),
        ('"not closed\nt,a\n0,1\n1,2\n', {"t": [0, 1], "a": [1, 2]}),
        ("t,a\n0,1\n\n1,\n2,3\n", {"t": [0, 1, 2], "a": [1, np.nan, 3]}),
        ("t,v\n0,\"[1, 2]\"\n1,\"[3, 4]\"\n", {"t": [0, 1], "v[0]": [1, 3], "v[1]": [2, 4]}),
        ("t\tq\u00b0\r\n0\t1\r\n1\t2\r\n", {"t": [0, 1], "q\u00b0": [1, 2]}),
    ],
)  # fmt: skip
@pytest.mark.parametrize("encoding", ["utf-8", "latin-1", "utf-16"])
def test_tables_are_recognised(
    tmp_path: Path, text: str, columns: dict[str, list[float]], encoding: str
) -> None:
    path = tmp_path / "log.csv"
    path.write_bytes(text.encode(encoding))
    (table,) = open_log(path).first()
    assert [*table.columns] == [*columns]
    for name, values in columns.items():
        np.testing.assert_array_equal(table.columns[name], values)


@settings(max_examples=60, deadline=None)
@given(
    values=st.lists(
        st.lists(st.floats(-1e6, 1e6), min_size=3, max_size=3), min_size=3, max_size=20
    ),
    separator=st.sampled_from([",", ";", "\t", "|", " "]),
    comma=st.booleans(),
    named=st.booleans(),
    above=st.lists(st.sampled_from(["Logger 5", "made: today", ""]), max_size=3),
    end=st.sampled_from(["\n", "\r\n"]),
)
def test_a_table_of_any_layout_keeps_its_numbers(
    tmp_path_factory: pytest.TempPathFactory, values: list[list[float]], separator: str,
    comma: bool, named: bool, above: list[str], end: str,
) -> None:  # fmt: skip
    comma &= separator != ","
    rows = [[f"{v:.6f}".replace(".", "," if comma else ".") for v in row] for row in values]
    lines = [*above, *[separator.join(row) for row in ([["a", "b", "c"]] * named + rows)]]
    path = tmp_path_factory.mktemp("table") / "log.csv"
    path.write_bytes((end.join(lines) + end).encode())
    (table,) = open_log(path).first()
    assert [*table.columns] == (["a", "b", "c"] if named else ["1", "2", "3"])
    read = np.stack([*table.columns.values()], axis=1)
    np.testing.assert_allclose(read, values, rtol=0, atol=1e-6)


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
        (["04.03.2025 10:11:12.345"], "2025-03-04T10:11:12.345"),
        (["04.03.25 10:11:12"], "2025-03-04T10:11:12"),
        (["13/03/2025 10:11:12"], "2025-03-13T10:11:12"),
        (["03/13/2025 12:11:12.5 AM"], "2025-03-13T00:11:12.5"),
        (["03/13/2025, 01:11:12 PM"], "2025-03-13T13:11:12"),
        (["04/03/2025 23:59:59", "05/03/2025 00:00:00"], "2025-03-04T23:59:59"),
        (["04/03/2025 23:59:59", "04/04/2025 00:00:00"], "2025-04-03T23:59:59"),
        (["2025/03/04 10:11:12,345"], "2025-03-04T10:11:12.345"),
        (["2025-03-04T10:11:12.345Z"], "2025-03-04T10:11:12.345"),
        (["2025-03-04T10:11:12.345+02:00"], "2025-03-04T08:11:12.345"),
        (["10:11:12.000000001"], "1970-01-01T10:11:12.000000001"),
    ],
)
def test_the_order_of_day_and_month_follows_from_the_data(
    tmp_path: Path, cells: list[str], expected: str
) -> None:
    (found,) = open_log(table(tmp_path / "log.csv", cells * 2)).first()
    assert found.columns["Time"][0] == np.datetime64(expected, "ns").astype(np.int64)
    assert found.units["Time"] == "ns"


@pytest.mark.parametrize("cell", ["04.13.2025 10:11:12", "x", "13:14.2"])
def test_what_is_no_date_stays_a_text(tmp_path: Path, cell: str) -> None:
    cells = ["13.04.2025 10:11:12", cell]
    (found,) = open_log(table(tmp_path / "log.csv", cells)).first()
    assert "Time" in found.texts


def test_a_table_with_german_dates_keeps_its_rate(home: Path, mapping: Mapped) -> None:
    log = table(home / "log.csv", stamps("04.03.2025"))
    mapped = mapping(f'[sources.log]\ntime = {{ column = "Time" }}\n{COLUMN}')
    run = import_recording([log], mapped, home / "out").runs[0]
    np.testing.assert_allclose(np.diff(run.time), 0.005, atol=1e-9)
