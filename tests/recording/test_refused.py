"""Recordings that are refused: the message names the file, the place, what is given and allowed."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from loose_env.errors import InvalidData
from loose_env.recording import read_recording, tables
from tests.recording.conftest import ARM, COS, TIME, Folder, csv_text

PLAIN = {"format": "loose-recording/1", "model": "model.xml", "runs": [{"file": "run.csv"}]}


def refused(home: Path, pattern: str, **arguments: Any) -> str:
    with pytest.raises(InvalidData) as error:
        read_recording(home, **arguments)
    words = str(error.value)
    assert re.search(pattern, words), words
    assert "\n" not in words
    return words


@pytest.mark.parametrize(
    ("change", "pattern"),
    [
        (
            {"format": "loose-recording/2"},
            r"'loose-recording/1' is needed, not 'loose-recording/2'",
        ),
        ({"format": ...}, r"is needed, not None"),
        ({"model": ...}, r"'model' is missing"),
        ({"runs": ...}, r"'runs' is missing"),
        ({"Runs": []}, r"unknown key 'Runs'; .*did you mean 'runs'"),
        ({"runs": []}, r"runs: .*at least 1"),
        ({"runs": ["run.csv"]}, r"runs\[0\]: a mapping is needed"),
        ({"runs": [{"file": 3}]}, r"runs\[0\]\.file: str is needed, not 3"),
        ({"runs": [{"file": "run.csv", "exited": []}]}, r"did you mean 'excited'"),
        (
            {"runs": [{"file": "run.csv", "condition": "good"}]},
            r"condition: 'good' is none of 'suspect' or 'healthy'",
        ),
        (
            {"runs": [{"file": "run.csv", "excited": "reach"}]},
            r"excited: a list is needed, not 'reach'",
        ),
        (
            {"runs": [{"file": "run.csv", "excited": ["reach"] * 2}]},
            r"excited: a joint stands twice",
        ),
        (
            {"runs": [{"file": "run.csv", "excited": ["reach", "sholder"]}]},
            r"runs\[0\]\.excited\[1\]: 'sholder' is no hinge.*did you mean 'shoulder'",
        ),
        ({"runs": [{"file": "run.csv", "pose": None}]}, r"pose: a mapping .* leave the key out"),
        ({"runs": [{"file": "run.csv", "pose": {"reach": True}}]}, r"pose\.reach: float is needed"),
        (
            {"runs": [{"file": "run.csv", "pose": {"reach": 10**400}}]},
            r"pose\.reach: float is needed",
        ),
        ({"runs": [{"file": "run.csv", "pose": {"elbow": 0}}]}, r"pose: 'elbow' is no hinge"),
        ({"runs": [{"file": "none.csv"}]}, r"runs\[0\]\.file: there is no file 'none\.csv'"),
        ({"runs": [{"file": "model.xml"}]}, r"has to end in \.parquet or \.csv"),
        ({"runs": [{"file": "run.csv"}, {"file": "./run.csv"}]}, r"'\./run\.csv' is the same file"),
        ({"model": "none.xml"}, r"model: there is no file 'none\.xml'"),
    ],
)
def test_descriptions_of_another_kind(folder: Folder, change: dict[str, Any], pattern: str) -> None:
    refused(folder(**change), rf"^recording\.json.*{pattern}")


@pytest.mark.parametrize(
    ("text", "pattern"),
    [
        ("", r"no JSON"),
        ("{", r"no JSON: .*line 1"),
        ("[]", r"is needed, not \[\]"),
        (json.dumps(PLAIN)[:-1] + ', "format": "loose-recording/1"}', r"key 'format' stands twice"),
        (
            '{"format": "loose-recording/1", "model": "model.xml", "runs": '
            '[{"file": "run.csv", "pose": {"reach": 0, "reach": 1}}]}',
            r"key 'reach' stands twice",
        ),
        *[
            (
                '{"format": "loose-recording/1", "model": "model.xml", "runs": '
                f'[{{"file": "run.csv", "pose": {{"reach": {word}}}}}]}}',
                r"is no number of JSON|finite position .*is needed|no JSON",
            )
            for word in ("NaN", "Infinity", "-Infinity", "1e999", "9" * 5000)
        ],
        (json.dumps(PLAIN).encode("utf-16"), r"line 1 is not UTF-8.*UTF-16"),
        (b'{"format": "\xff"}', r"line 1 is not UTF-8: byte 13 is 0xff"),
        ("[" * 100_000, r"no JSON: .*recursion"),
        (json.dumps(PLAIN | {"model": "\ud800.xml"}), r"model: .*unicode"),
    ],
)
def test_files_that_are_no_json(folder: Folder, text: str | bytes, pattern: str) -> None:
    refused(folder({"recording.json": text}), rf"^recording\.json: .*({pattern})")


def test_a_byte_order_mark_before_the_description_is_taken(folder: Folder) -> None:
    home = folder({"recording.json": b"\xef\xbb\xbf" + json.dumps(PLAIN).encode()})
    assert len(read_recording(home).runs) == 1


@pytest.mark.parametrize(
    ("path", "pattern"),
    [
        ("../outside.csv", "leaves the folder"),
        ("a/../../outside.csv", "leaves the folder"),
        ("/etc/passwd", "is absolute"),
        ("C:/run.csv", "is absolute"),
        ("..\\outside.csv", "is no path"),
        ("run.csv\0", "is no path"),
        ("run\n.csv", "is no path"),
        ("link.csv", "leaves the folder"),
        ("away/outside.csv", "leaves the folder"),
        ("loop.csv", "leads nowhere|there is no file"),
        ("x" * 5000 + ".csv", "cannot be read|there is no file|leads nowhere"),
        ("pipe.csv", "there is no file"),
    ],
)
@pytest.mark.parametrize("key", ["model", "file"])
def test_paths_that_leave_the_folder(
    folder: Folder, tmp_path: Path, key: str, path: str, pattern: str
) -> None:
    tmp_path.joinpath("outside.csv").write_text("time,sensor.angle\n")
    change = {"model": path} if key == "model" else {"runs": [{"file": path}]}
    home = folder(**change)
    home.joinpath("link.csv").symlink_to(tmp_path / "outside.csv")
    home.joinpath("away").symlink_to(tmp_path)
    home.joinpath("loop.csv").symlink_to("loop.csv")
    os.mkfifo(home / "pipe.csv")  # opening it would wait for ever
    refused(home, rf"^recording\.json: (model|runs\[0\]\.file): .*({pattern})")


def test_a_second_name_of_the_same_file(folder: Folder) -> None:
    home = folder(runs=[{"file": "run.csv"}, {"file": "twin.csv"}])
    home.joinpath("twin.csv").symlink_to("run.csv")
    refused(home, r"runs\[1\]\.file: 'twin\.csv' is the same file as 'run\.csv'")
    home.joinpath("twin.csv").unlink()
    os.link(home / "run.csv", home / "twin.csv")
    refused(home, r"runs\[1\]\.file: 'twin\.csv' is the same file as 'run\.csv'")


def test_folders_that_are_not_there(tmp_path: Path) -> None:
    refused(tmp_path / "none", r"there is no folder .*none")
    refused(tmp_path, r"there is no file 'recording\.json'")
    file = tmp_path / "file"
    file.write_text("")
    refused(file, r"there is no folder .*file'; a recording is a folder; 'loose import' makes one")
    with pytest.raises(InvalidData, match="no folder"):
        read_recording(3)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("text", "pattern"),
    [
        (ARM[:300], r"not XML"),
        ("<svg/>", r"outermost element is <svg>"),
        (ARM.replace("<motor", "<mtoor"), r"MuJoCo cannot read it: .*mtoor"),
        (ARM.replace('joint="reach" kp', 'joint="rech" kp'), r"MuJoCo cannot build it: .*rech"),
        (ARM.replace('name="rate"', 'name="angle"'), r"repeated name 'angle'"),
        (ARM.replace('kp="100"', 'kp="nan"'), r"actuator_gainprm has to be finite|cannot"),
        (ARM.encode().replace(b"upper", b"\xfcber"), "not XML"),
        (ARM.replace("<mujoco>", "<mujoco><include file='away/other.xml'/>"), "lies outside"),
    ],
)
def test_models_that_do_not_compile(
    folder: Folder, tmp_path: Path, text: str | bytes, pattern: str
) -> None:
    tmp_path.joinpath("other.xml").write_text("<mujocoinclude/>")
    home = folder({"model.xml": text})
    home.joinpath("away").symlink_to(tmp_path)
    refused(home, rf"^model\.xml: .*({pattern})")


def at(file: str, column: str, row: int) -> str:
    where = "counted from 1" if file.endswith("parquet") else f"line {row + 1} of the file"
    return re.escape(f"{file}: column '{column}', row {row} ({where})")


def put(values: list[str], row: int, value: str) -> list[str]:
    """Values with one of them replaced; ``row`` counts from 1, as messages do."""
    return [*values[: row - 1], value, *values[row:]]


def changed(row: int, value: float) -> np.ndarray:
    return np.where(np.arange(20) == row - 1, value, TIME)


TOOL = {f"sensor.tool.{axis}": TIME for axis in "xyz"}
TABLES = [
    ({"sensor.angle": TIME, "time": changed(7, np.inf)}, ("time", 7), "inf is not finite"),
    ({**TOOL, "sensor.tool.y": changed(1, -np.inf)}, ("sensor.tool.y", 1), "-inf is not finite"),
    ({"torque.reach": changed(20, np.inf)}, ("torque.reach", 20), "inf is not finite"),
    ({"sensor.angle": TIME, "time": changed(2, 0.0)}, ("time", 2), "increase strictly.*0.0 s"),
    ({"sensor.angle": TIME, "time": changed(20, 0.18)}, ("time", 20), "increase strictly.*0.18"),
    ({"sensor.angle": TIME, "time": changed(9, -1.0)}, ("time", 9), "increase strictly.*-1.0"),
    ({"sensor.angle": TIME, "time": changed(12, np.nan)}, ("time", 12), "the time is missing"),
    (
        {**TOOL, "sensor.tool.z": np.where(np.arange(20) % 4 == 3, np.nan, 0.0)},
        ("sensor.tool.z", 4), r"5 missing samples, 25\.0%",
    ),
    ({"time": TIME[:9], "sensor.angle": TIME[:9]}, ("time", 9), "9 samples; it needs at least 10"),
    ({"time": TIME[:0], "sensor.angle": TIME[:0]}, None, "'time', row 0.* 0 samples"),
    ({"ctrl.lift": TIME}, None, "no column of data"),
    ({"sensor.tool.x": TIME}, None, r"3-vector, and 'sensor\.tool\.y' and 'sensor\.tool\.z'"),
    *[
        ({"sensor.angle": TIME, column: TIME}, None, rf"{re.escape(repr(column))}, row 0.*{words}")
        for column, words in (
            ("CTRL.Lift", "did you mean 'ctrl.lift'"),
            ("Time", "did you mean 'time'"),
            ("sensor.shoulder", "allowed are 'sensor.angle', 'sensor.rate', 'sensor.stroke'"),
            ("torque.lift", "allowed are 'torque.shoulder', 'torque.reach', 'torque.aside'"),
            ("sensor.", "names nothing"),
            ("__index_level_0__", "names nothing"),
            ("sensor.tool", "its columns are sensor.tool.x, sensor.tool.y, sensor.tool.z"),
            ("sensor.rate.x", "its column is 'sensor.rate'"),
            ("sensor.turned.x", "reads 4 values"),
        )
    ],
]  # fmt: skip


@pytest.mark.parametrize("file", ["bad.csv", "bad.parquet"])
@pytest.mark.parametrize(("columns", "place", "words"), TABLES)
def test_tables_that_are_no_run(
    folder: Folder, columns: dict[str, Any], place: tuple[str, int] | None, words: str, file: str
) -> None:
    home, given = folder(runs=[{"file": file}]), {"time": TIME, **columns}
    if file.endswith("csv"):
        home.joinpath(file).write_text(csv_text(**{k: v.tolist() for k, v in given.items()}))
    else:
        pq.write_table(pa.table(given), home / file)
    refused(home, f"^{at(file, *place) if place else file}.*{words}")


@pytest.mark.parametrize(
    ("change", "column", "words"),
    [
        (
            ('<joint name="aside"/>', '<freejoint name="aside"/>'),
            "torque.aside", "neither a hinge nor a slide",
        ),
        (('name="rate"', 'name="tool.y"'), "sensor.tool.y", "rename one"),
    ],
)  # fmt: skip
def test_columns_that_the_model_cannot_place(
    folder: Folder, change: tuple[str, str], column: str, words: str
) -> None:
    model = ARM.replace('<jointpos name="aside_angle" joint="aside"/>', "").replace(*change)
    files = {"model.xml": model, "run.csv": csv_text(**{"sensor.angle": COS, column: COS})}
    refused(folder(files), f"column '{column}'.*{words}")


@pytest.mark.parametrize(
    "cell", ["abc", "1.5 m", "1_000", "٣", "0x10", "1,5", "NA", "1e", "true", "\0", "a" * 99]
)
def test_text_where_a_number_belongs_in_csv(folder: Folder, cell: str) -> None:
    home = folder({"run.csv": csv_text(sensor__angle=put(COS, 13, f'"{cell}"'))})
    refused(home, f"^{at('run.csv', 'sensor.angle', 13)}.* is no number")


def test_the_row_is_right_far_down_a_long_file(folder: Folder) -> None:
    clock = [str(i) for i in range(40_000)]
    text = csv_text(time=clock, sensor__angle=put(["1"] * 40_000, 33_333, "x"))
    refused(folder({"run.csv": text}), at("run.csv", "sensor.angle", 33_333))


@pytest.mark.parametrize(
    ("kind", "value"),
    [
        (pa.string(), "1.5"),
        (pa.bool_(), True),
        (pa.timestamp("ns"), 5),
        (pa.list_(pa.float64()), [1.0]),
        (pa.binary(), b"1"),
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
    refused(home, f"^{at('run.parquet', column, 3)}.* where a number belongs")
    columns[column] = pa.nulls(20)
    pq.write_table(pa.table(columns), home / "run.parquet")
    refused(home, f"^{at('run.parquet', column, 1)}.*missing")


def test_a_column_that_is_there_twice(folder: Folder) -> None:
    text = csv_text(sensor__angle=COS).replace("time,sensor.angle", "time,time")
    refused(folder({"run.csv": text}), r"^run\.csv: column 'time', row 0 .*is there twice")
    home = folder(runs=[{"file": "run.parquet"}])
    names = ["time", "sensor.angle", "sensor.angle"]
    pq.write_table(pa.table([pa.array(TIME)] * 3, names=names), home / "run.parquet")
    refused(home, r"^run\.parquet: column 'sensor\.angle', row 0 .*is there twice")


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
    refused(folder({"run.csv": text}), rf"^run\.csv: .*?{where}")


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
    home = folder({"run.parquet": whole[:end]}, runs=[{"file": "run.parquet"}])
    refused(home, r"^run\.parquet: .*(empty|not a whole Parquet file)")


@pytest.mark.parametrize("seed", range(12))
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


@pytest.mark.parametrize("file", ["run.csv", "run.parquet"])
def test_a_table_too_large_to_hold(
    folder: Folder, monkeypatch: pytest.MonkeyPatch, file: str
) -> None:
    monkeypatch.setattr(tables, "MOST_VALUES", 1000)
    text = csv_text(time=range(2000), sensor__angle=range(2000))
    files = {"run.csv": text, "run.parquet": parquet_bytes(2000)}
    refused(folder(files, runs=[{"file": file}]), f"^{file}: 2000 rows of 2 columns.*Split the run")
