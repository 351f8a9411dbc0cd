"""Tables that are refused: the message names the file, the column and the row."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from loose_env.errors import InvalidData
from loose_env.recording import read_recording, table
from tests.recording.hand_made import ARM, TIME, csv_text

Folder = Callable[..., Path]
COS = [repr(float(v)) for v in np.cos(TIME)]
CLOCK = [f"{t:g}" for t in TIME]


def put(values: list[str], row: int, value: str) -> list[str]:
    """Values with one of them replaced; ``row`` counts from 1, as messages do."""
    return [*values[: row - 1], value, *values[row:]]


def at(file: str, column: str, row: int) -> str:
    where = "counted from 1" if file.endswith("parquet") else f"line {row + 1} of the file"
    return f"{file}: column '{column}', row {row} ({where})"


def message(home: Path) -> str:
    with pytest.raises(InvalidData) as refused:
        read_recording(home)
    return str(refused.value)


@pytest.fixture(params=["csv", "parquet"])
def refused(request: pytest.FixtureRequest, folder: Folder) -> Callable[..., tuple[str, str]]:
    """File and message of a refused run whose columns are given as numbers."""

    def read(**columns: Any) -> tuple[str, str]:
        file = f"bad.{request.param}"
        given = {"time": TIME} | {
            (k if k[0] == "_" else k.replace("__", ".")): np.array(v) for k, v in columns.items()
        }
        home = folder(runs=[{"file": file}])
        if request.param == "csv":
            home.joinpath(file).write_text(csv_text(**{k: v.tolist() for k, v in given.items()}))
        else:
            pq.write_table(pa.table(given), home / file)
        return file, message(home)

    return read


@pytest.mark.parametrize("row", [1, 7, 20])
@pytest.mark.parametrize("value", [np.inf, -np.inf])
@pytest.mark.parametrize("column", ["time", "sensor.tool.y", "ctrl.lift", "torque.reach"])
def test_infinities(refused: Callable[..., Any], column: str, row: int, value: float) -> None:
    columns = {f"sensor.tool.{a}": np.cos(TIME) for a in "xyz"}
    columns |= {"ctrl.lift": np.cos(TIME), "torque.reach": np.cos(TIME), "time": TIME.copy()}
    columns[column][row - 1] = value
    file, words = refused(**columns)
    assert at(file, column, row) in words
    assert f"{value} is not finite" in words


@pytest.mark.parametrize(
    ("row", "value"), [(2, 0.0), (9, 0.07), (9, -1.0), (20, 0.18), (14, 0.129999999)]
)
def test_time_that_does_not_increase(refused: Callable[..., Any], row: int, value: float) -> None:
    time = TIME.copy()
    time[row - 1] = value
    if row == 14:
        time[row - 2] = 0.13
    file, words = refused(time=time, sensor__angle=TIME)
    assert at(file, "time", row) in words
    assert "increase strictly" in words and repr(value) in words


@pytest.mark.parametrize("row", [1, 12, 20])
def test_a_missing_time(refused: Callable[..., Any], row: int) -> None:
    time = TIME.copy()
    time[row - 1] = np.nan
    file, words = refused(time=time, sensor__angle=TIME)
    assert at(file, "time", row) in words and "the time is missing" in words


@pytest.mark.parametrize("axis", ["", ".x", ".z"])
def test_a_column_with_more_than_a_fifth_missing(refused: Callable[..., Any], axis: str) -> None:
    columns = {f"sensor.tool.{a}": np.cos(TIME) for a in "xyz"} | {"sensor.rate": np.cos(TIME)}
    name = f"sensor.tool{axis}" if axis else "sensor.rate"
    columns[name][[4, 8, 9, 10, 19]] = np.nan
    file, words = refused(**columns)
    assert at(file, name, 5) in words
    assert "5 missing" in words and "25.0%" in words


@pytest.mark.parametrize("samples", [0, 1, 9])
def test_fewer_than_ten_samples(refused: Callable[..., Any], samples: int) -> None:
    file, words = refused(time=TIME[:samples], sensor__angle=TIME[:samples])
    assert words.startswith(f"{file}: column 'time', row {samples}")
    assert f"{samples} samples; it needs at least 10" in words


def test_ten_samples_are_enough(folder: Folder) -> None:
    text = csv_text(time=CLOCK[:10], sensor__angle=COS[:10])
    assert read_recording(folder({"run.csv": text})).runs[0].samples == 10


@pytest.mark.parametrize(
    ("column", "reason"),
    [
        ("ctrl.lif", "did you mean 'ctrl.lift'?"),
        ("CTRL.Lift", "did you mean 'ctrl.lift'?"),
        ("Time", "did you mean 'time'?"),
        ("sensor.shoulder", "allowed are 'sensor.angle', 'sensor.rate', 'sensor.stroke'"),
        ("torque.lift", "allowed are 'torque.shoulder', 'torque.reach', 'torque.aside'"),
        ("sensor.", "names nothing"),
        (" ctrl.lift", "did you mean 'ctrl.lift'?"),
        ("__index_level_0__", "names nothing"),
        ("sensor.tool", "its columns are sensor.tool.x, sensor.tool.y, sensor.tool.z"),
        ("sensor.rate.x", "its column is 'sensor.rate'"),
        ("sensor.turned", "reads 4 values"),
        ("sensor.turned.x", "reads 4 values"),
    ],
)
def test_a_column_that_names_nothing(refused: Callable[..., Any], column: str, reason: str) -> None:
    file, words = refused(**{"sensor.angle": TIME, column: TIME})
    assert f"{file}: column {column!r}, row 0 (the header)" in words
    assert reason in words


@pytest.mark.parametrize("given", ["x", "yz", "xz"])
def test_half_a_vector(refused: Callable[..., Any], given: str) -> None:
    file, words = refused(**{f"sensor.tool.{a}": TIME for a in given})
    assert f"{file}: column 'sensor.tool.{given[0]}', row 0" in words
    for axis in set("xyz") - set(given):
        assert f"'sensor.tool.{axis}'" in words.split("3-vector")[1]


@pytest.mark.parametrize("columns", [{}, {"ctrl.lift": TIME}])
def test_no_column_of_data(refused: Callable[..., Any], columns: dict[str, Any]) -> None:
    file, words = refused(**columns)
    assert words.startswith(f"{file}: ") and "no column of data" in words


def test_no_time(folder: Folder) -> None:
    words = message(folder({"run.csv": "sensor.angle,sensor.rate\n" + "1,2\n" * 20}))
    assert "run.csv: column 'time', row 0 (the header): the column is missing" in words


def test_columns_of_elements_that_have_no_single_value(folder: Folder) -> None:
    free = ARM.replace('<joint name="aside"/>', '<freejoint name="aside"/>').replace(
        '<jointpos name="aside_angle" joint="aside"/>', ""
    )
    words = message(folder({"model.xml": free, "run.csv": csv_text(torque__aside=COS)}))
    assert "column 'torque.aside'" in words and "neither a hinge nor a slide" in words


def test_a_name_that_two_sensors_share_is_no_guess(folder: Folder) -> None:
    doubtful = ARM.replace('name="rate"', 'name="tool.y"')
    text = csv_text(sensor__angle=COS, sensor__tool__y=COS)
    words = message(folder({"model.xml": doubtful, "run.csv": text}))
    assert "column 'sensor.tool.y'" in words and "rename one" in words


@pytest.mark.parametrize("row", [1, 13, 20])
@pytest.mark.parametrize(
    "cell", ["abc", "1.5 m", "1_000", "٣", "0x10", "1,5", "NA", "--", "1e", "true", "\0", "a" * 99]
)
def test_text_where_a_number_belongs_in_csv(folder: Folder, cell: str, row: int) -> None:
    cell = f'"{cell}"'
    words = message(folder({"run.csv": csv_text(sensor__angle=put(COS, row, cell))}))
    assert at("run.csv", "sensor.angle", row) in words
    assert "is no number" in words


def test_the_row_is_right_far_down_a_long_file(folder: Folder) -> None:
    clock = [str(i) for i in range(40_000)]
    values = put(["1"] * 40_000, 33_333, "x")
    words = message(folder({"run.csv": csv_text(time=clock, sensor__angle=values)}))
    assert at("run.csv", "sensor.angle", 33_333) in words


@pytest.mark.parametrize(
    ("kind", "value"),
    [
        (pa.string(), "1.5"),
        (pa.large_string(), "x"),
        (pa.bool_(), True),
        (pa.timestamp("ns"), 5),
        (pa.list_(pa.float64()), [1.0]),
        (pa.struct({"a": pa.float64()}), {"a": 1.0}),
        (pa.binary(), b"1"),
        (pa.date32(), 3),
        (pa.duration("ns"), 7),
    ],
)
@pytest.mark.parametrize("column", ["time", "sensor.angle"])
def test_other_things_than_numbers_in_parquet(
    folder: Folder, kind: pa.DataType, value: Any, column: str
) -> None:
    columns: dict[str, Any] = {"time": TIME, "sensor.angle": TIME}
    columns[column] = pa.array([None, None, *[value] * 18], type=kind)
    home = folder(runs=[{"file": "run.parquet"}])
    pq.write_table(pa.table(columns), home / "run.parquet")
    words = message(home)
    assert at("run.parquet", column, 3) in words and "where a number belongs" in words


def test_a_column_of_nothing_but_nulls(folder: Folder) -> None:
    home = folder(runs=[{"file": "run.parquet"}])
    columns = {"time": pa.array(TIME), "sensor.angle": pa.nulls(20)}
    pq.write_table(pa.table(columns), home / "run.parquet")
    words = message(home)
    assert at("run.parquet", "sensor.angle", 1) in words and "20 missing" in words


def test_a_column_that_is_there_twice(folder: Folder) -> None:
    text = csv_text(sensor__angle=COS).replace("time,sensor.angle", "time,time")
    words = message(folder({"run.csv": text}))
    assert "run.csv: column 'time', row 0 (the header): the column is there twice" in words
    home = folder(runs=[{"file": "run.parquet"}])
    names = ["time", "sensor.angle", "sensor.angle"]
    pq.write_table(pa.table([pa.array(TIME)] * 3, names=names), home / "run.parquet")
    assert "run.parquet: column 'sensor.angle', row 0 (the header): the column is" in message(home)


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ("", r"line 1: no column is named"),
        ("\n\n", r"line 1: no column is named"),
        ("0.0,1.0\n" * 20, r"column '0\.0', row 0 .*starts with a line that names its columns"),
        (csv_text(sensor__angle=COS).replace(",", ";"), r"line 1: .*parted by semicolons"),
        (csv_text(sensor__angle=COS).replace(",", "\t"), r"line 1: .*parted by tabs"),
        (
            csv_text(sensor__angle=put(COS, 6, "1,2")),
            r"column 'sensor\.angle', row 6 \(line 7 .*3 cells, the header 2",
        ),
        (
            csv_text(sensor__angle=COS).replace("0.05,", "0.05"),
            r"column 'sensor\.angle', row 6 \(line 7 .*1 cells, the header 2",
        ),
        (
            csv_text(sensor__angle=COS).replace("\n0.05", "\n\n0.05"),
            r"column 'time', row 6 \(line 7 .*blank",
        ),
        (csv_text(sensor__angle=put(COS, 4, '"1')), r"not CSV"),
        (csv_text(sensor__angle=put(COS, 4, '"1"2')), r"line 5: not CSV"),
        (csv_text(sensor__angle=put(COS, 4, "9" * 200_000)), r"line 5: not CSV"),
        (csv_text(sensor__angle=put(COS, 4, "é")).encode("latin-1"), r"line 5 is not UTF-8"),
        (csv_text(sensor__angle=COS).encode("utf-16"), r"line 1 is not UTF-8.*UTF-16"),
        (b"PAR1" + bytes(range(256)) * 9, r"line \d is not UTF-8"),
    ],
)
def test_files_that_are_no_csv(folder: Folder, text: str | bytes, where: str) -> None:
    words = message(folder({"run.csv": text}))
    assert re.match(rf"run\.csv: .*?{where}", words), words


def parquet_bytes(rows: int = 2000) -> bytes:
    sink = pa.BufferOutputStream()
    rng = np.random.default_rng(1)
    columns = {"time": np.arange(float(rows)), "sensor.angle": rng.normal(size=rows)}
    pq.write_table(pa.table(columns), sink, write_page_checksum=True)
    return sink.getvalue().to_pybytes()


@pytest.mark.parametrize("kept", [0, 1, 4, 8, 12, 100, 0.5, -1, -8, -100])
def test_parquet_that_is_cut_short(folder: Folder, kept: float) -> None:
    whole = parquet_bytes()
    end = int(kept * len(whole)) if isinstance(kept, float) else kept
    words = message(folder({"run.parquet": whole[:end]}, runs=[{"file": "run.parquet"}]))
    assert words.startswith("run.parquet: ")
    assert "empty" in words or "not a whole Parquet file" in words


@pytest.mark.parametrize("seed", range(60))
def test_damaged_parquet_reads_as_it_was_or_is_refused(folder: Folder, seed: int) -> None:
    rng = np.random.default_rng(seed)
    whole = bytearray(parquet_bytes(200))
    for place in rng.integers(0, len(whole), size=1 + seed % 4):
        whole[place] ^= 1 << rng.integers(8)
    home = folder({"run.parquet": bytes(whole)}, runs=[{"file": "run.parquet"}])
    try:
        (run,) = read_recording(home).runs
    except InvalidData as error:
        assert str(error).startswith("run.parquet: ")
    else:
        np.testing.assert_array_equal(run.time, np.arange(200.0))
        angle = np.random.default_rng(1).normal(size=200)
        np.testing.assert_array_equal(run.sensors["angle"], angle)


def test_csv_named_parquet_and_parquet_named_csv(folder: Folder) -> None:
    text = csv_text(sensor__angle=COS)
    assert "not a whole Parquet" in message(
        folder({"a.parquet": text}, runs=[{"file": "a.parquet"}])
    )
    words = message(folder({"a.csv": parquet_bytes()}, runs=[{"file": "a.csv"}]))
    assert words.startswith("a.csv: ")


@pytest.mark.parametrize("file", ["run.csv", "run.parquet"])
def test_a_table_too_large_to_hold(
    folder: Folder, monkeypatch: pytest.MonkeyPatch, file: str
) -> None:
    monkeypatch.setattr(table, "MOST_VALUES", 1000)
    text = csv_text(time=range(2000), sensor__angle=range(2000))
    files = {"run.csv": text, "run.parquet": parquet_bytes(2000)}
    words = message(folder(files, runs=[{"file": file}]))
    assert words.startswith(f"{file}: 2000 rows of 2 columns") and "Split the run" in words
