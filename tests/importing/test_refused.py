"""What cannot be used is refused in one line that names the file and the place."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import zstandard
from mcap.writer import CompressionType

from loose_env.cli.main import main
from loose_env.errors import InvalidData, LooseEnvError
from loose_env.importing import describe_sources, import_recording
from tests.importing.sample_files import (
    IMU,
    JOINT_STATE,
    imu,
    joint_states,
    motion,
    write_csv,
    write_json_mcap,
    write_robot,
    write_ros2,
    write_uff,
)

Mapped = Callable[..., Path]

ONE = '[sources.s]\n{source}\n[columns]\n"sensor.{column}" = {{ {channel} }}\n[[runs]]\n{run}\n'
TIME = np.arange(50) / 100


def one(channel: str, *, source: str = "", column: str = "elbow_angle", run: str = "") -> str:
    return ONE.format(source=source, column=column, channel=channel, run=run)


def refused(home: Path, file: Path, mapped: Path) -> str:
    """The message, after making sure that it is one line and nothing was written."""
    before = sorted(home.iterdir())
    with pytest.raises(LooseEnvError) as error:
        import_recording([file], mapped, home / "out")
    assert sorted(home.iterdir()) == before
    assert "\n" not in str(error.value)
    return str(error.value)


@pytest.mark.parametrize(
    ("channel", "words"),
    [
        ('topic = "/joint_state", channel = "position[elbow]"', "did you mean '/joint_states'"),
        ('channel = "position[elbow]"', "say which by topic"),
        ('topic = "/joint_states", channel = "positon[elbow]"', "did you mean 'position'"),
        ('topic = "/joint_states", channel = "position[wrist]"', "none of its 400 messages"),
        ('topic = "/joint_states", channel = "position[9]"', "none of its 400 messages"),
        ('topic = "/joint_states", channel = "position"', "is no number"),
        ('topic = "/joint_states", channel = "header"', "is no number; it holds stamp"),
        ('topic = "/joint_states", channel = "header.frame_id"', "is no number"),
        ('topic = "/imu", channel = "linear_acceleration[0]"', "is no array"),
        ('topic = "/commands", channel = "data[lift]"', "have no names; take one by its number"),
        ('topic = "/imu", channel = "a..b"', "no way to a number"),
        ('topic = "/imu", channel = "linear_acceleration.x", unit = "g"', "measures acceleration"),
        ('topic = "/imu", channel = "linear_acceleration.x", unit = "furlong"', "unknown unit"),
    ],
)
def test_channels_that_are_not_there(home: Path, mapping: Mapped, channel: str, words: str) -> None:
    bag = write_robot(home / "robot.mcap")
    said = refused(home, bag, mapping(one(channel)))
    assert words in said
    assert "robot.mcap" in said or "map.toml" in said


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (one('channel = "q"', column="elbow_angel"), "did you mean 'sensor.elbow_angle'"),
        (one('channel = "q"', run='pose = { wrist = 1 }'), "no hinge or slide"),
        (one('channel = "q"', run='pose = { elbow = "3 kg" }'), "unknown unit 'kg'"),
        (one('channel = "q"', run='file = "../../run"'), "leaves the folder"),
        (one('channel = "q"', run='file = "/etc/run"'), "is absolute"),
        (one('channel = "q"', run="start = 1.7e9"), "give a date in quotes"),
        (one('channel = "q"', run="start = 0.3\nstop = 0.1"), "start is not before stop"),
        (one('channel = "q"', run="start = 0.1\nstop = 7"), "not within what all its channels"),
        (one('channel = "q"', run="rate_hz = 1e9"), "more than"),
        (one('channel = "q"', run="rate_hz = 5"), "at least 10"),
        (one('channel = "q"', run='condition = "sound"'), "'suspect', 'healthy'"),
        (one('channel = "q", sign = 2'), "sign is 1 or -1"),
        (one('channel = "q", scale = 0'), "leaves nothing"),
        (one('channel = "q", scale = inf'), "is a number from"),
        (one('channel = "q", topic = "/a"'), "has no topics"),
        (one('channel = "w"'), "there is no column 'w'"),
        (one('channel = "q", sources = "x"'), "did you mean 'source'"),
        (one('channel = "q", source = "t"'), "there is no source 't'"),
        (one('channel = "q"', source='separator = ";"'), "there is no column"),
        (one('channel = "q"', source='separator = ";"\ndecimal = ";"'), "is one of '.', ','"),
        (one('channel = "q"', source='time = { column = "t", unit = "kg" }'), "unknown unit"),
        (one('channel = "q"', source='time = { column = "t", unit = "g" }'), "no unit of time"),
        ("[sources.s]\n", "runs is a list"),
        ("[[runs]]\n", "[sources.NAME] is missing"),
        ('[sources.s]\n[sources.s.align]\nto = "s"\nchannel = "a"\nto_channel = "b"\n[[runs]]\n',
         "not aligned itself"),
        ("[sources", "not TOML"),
        (f"a = {'[' * 100000}", "nested too deeply"),
        (f"a = {'9' * 5000}", "not TOML"),
    ],
)  # fmt: skip
def test_mappings_that_make_no_sense(home: Path, mapping: Mapped, text: str, words: str) -> None:
    log = write_csv(home / "log.csv", np.stack([TIME, TIME], 1), ["t", "q"])
    if "time =" not in text and "[sources.s]\n" in text and "align" not in text:
        text = text.replace("[sources.s]\n", '[sources.s]\ntime = { column = "t" }\n')
    said = refused(home, log, mapping(text))
    assert words in said
    assert "map.toml" in said or "log.csv" in said or "run " in said


def test_a_model_outside_the_mapping_s_folder_is_for_the_command_line(home: Path) -> None:
    log = write_csv(home / "log.csv", np.stack([TIME, TIME], 1), ["t", "q"])
    inner = home / "maps"
    inner.mkdir()
    for model in ("../arm.xml", str(home / "arm.xml")):
        path = inner / "map.toml"
        path.write_text(
            f'format = "loose-mapping/1"\nmodel = "{model}"\n'
            + one('channel = "q"', source='time = { column = "t" }')
        )
        assert "given by --model" in refused(home, log, path)
    assert import_recording([log], path, home / "out", model=home / "arm.xml").runs


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        (["t,q", "0,1", "1,two", "2,3"], "line 3, column 'q': 'two' is no number"),
        (["t,q", "0,1", "1,1_0", "2,3"], "is no number"),
        (["t,q", "0,1", "1,2,5", "2"], "line 4: 1 cells, and 2 columns"),
        (["t,q", "0,1", "2,2", "1,3"], "line 4: time runs backwards"),
        (["t,q", "0,1", "1,2", "1,3"], "line 4: time stands still"),
        (["t,q", "0,1", ",2", "1,3"], "line 3, column 't': '' is no time"),
        (["t,q", "0,1", "1e999,2", "1,3"], "line 3, column 't'"),
        (["t,q", "0,1", "1,inf", "2,3"], "line 3: the value is infinite"),
        (["t,q", "0,1", "1,1e999", "2,3"], "line 3: the value is infinite"),
        (["t,q"], "it has 0 samples"),
        (["t,q", "0,", "1,", "2,nan"], "it has 0 samples"),
        (["t,q,q", "0,1,1"], "is there 2 times; take one by its number, #2 or #3"),
        ([], "there is no table"),
        (["t,q", '0,"1', "1,2"], "not a table"),
        (["t,q", "0,\0"], "no"),
        (["t,q" + "x" * 2**20, "0,1"], "longer than"),
    ],
)
def test_tables_that_are_damaged(home: Path, mapping: Mapped, lines: list[str], words: str) -> None:
    (home / "log.csv").write_text("\n".join(lines))
    said = refused(home, home / "log.csv", mapping(one('channel = "q"', source=CLOCK)))
    assert words in said
    assert said.startswith("log.csv")


CLOCK = 'time = { column = "t" }'


def test_tables_of_another_encoding_say_which(home: Path, mapping: Mapped) -> None:
    for encoding, words in (("utf-16", "encoding = 'utf-16'"), ("latin-1", "'latin-1'")):
        (home / "log.csv").write_text("t,q°\n0,1\n1,2\n", encoding=encoding)
        assert words in refused(home, home / "log.csv", mapping(one('channel = "q"', source=CLOCK)))


def test_a_column_that_misses_more_than_a_fifth(home: Path, mapping: Mapped) -> None:
    rows = np.stack([TIME, TIME, np.where((TIME > 0.1) & (TIME < 0.3), np.nan, 1)], 1)
    write_csv(home / "log.csv", rows, ["t", "q", "w"])
    text = one('channel = "q"', source=CLOCK).replace(
        "[[runs]]", '"sensor.shoulder_rate" = { channel = "w" }\n[[runs]]'
    )
    said = refused(home, home / "log.csv", mapping(text))
    assert "'sensor.shoulder_rate', from log.csv: column 'w': 38% of 50 rows" in said
    assert "0.110 s after the start" in said


def test_sources_that_never_meet(home: Path, mapping: Mapped) -> None:
    bag = write_robot(home / "robot.mcap")
    log = write_csv(home / "log.csv", np.stack([TIME, TIME], 1), ["t", "q"])
    text = (
        '[sources.robot]\n[sources.log]\ntime = { column = "t" }\n[columns]\n'
        '"sensor.elbow_angle" = { source = "log", channel = "q" }\n'
        '"sensor.shoulder_angle" = { source = "robot", topic = "/joint_states", '
        'channel = "position[shoulder]" }\n[[runs]]\n'
    )
    with pytest.raises(InvalidData, match=r"no time in common.*from_start"):
        import_recording([bag, log], mapping(text), home / "out")


@pytest.mark.parametrize("relation", ["another", "periodic"])
def test_clocks_are_not_set_by_motions_that_do_not_tell(
    home: Path, mapping: Mapped, relation: str
) -> None:
    time = np.arange(3000) / 1000
    own = motion(time)["x"] if relation == "another" else np.sin(40 * time)
    other = motion(time)["shoulder"] if relation == "another" else np.sin(40 * time)
    a = write_csv(home / "a.csv", np.stack([time, own], 1), ["t", "q"])
    b = write_csv(home / "b.csv", np.stack([time, other], 1), ["t", "w"])
    text = (
        '[sources.a]\ntime = { column = "t" }\n[sources.a.align]\nto = "b"\nchannel = "q"\n'
        'to_channel = "w"\n[sources.b]\ntime = { column = "t" }\n[columns]\n'
        '"sensor.elbow_angle" = { source = "a", channel = "q" }\n[[runs]]\n'
    )
    words = {"another": "agree at no shift", "periodic": "motion repeats itself"}[relation]
    with pytest.raises(InvalidData, match=words):
        import_recording([a, b], mapping(text), home / "out")


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.bag", b"#ROSBAG V2.0", "mcap convert"),
        ("a.pkl", b"\x80\x04", "can hold code"),
        ("a.mcap", b"SQLite format 3", "does not start with"),
        ("a.mcap", b"", "does not start with"),
        ("a.xyz", b"hello", "of what kind is it"),
        ("a.uff", b"hello", "no lines '    -1'"),
        ("a.uff", b"    -1\n    58\nNONE\n", "cut short"),
        ("a.uff", b"    -1\n   151\nNONE\n    -1\n", "has no data set 58"),
        ("a.uff", b"    -1\n    58\nNONE\n    -1\n", "damaged"),
    ],
)
def test_files_that_are_something_else(
    home: Path, mapping: Mapped, name: str, content: bytes, words: str
) -> None:
    (home / name).write_bytes(content)
    mapped = mapping(one('topic = "/a", channel = "q"'))
    assert words in refused(home, home / name, mapped)


def chunk(size: int, kind: bytes, packed: bytes) -> bytes:
    """An MCAP file of one chunk, as a hostile hand writes it."""
    body = struct.pack("<QQQI", 0, 0, size, 0) + struct.pack("<I", len(kind)) + kind
    body += struct.pack("<Q", len(packed)) + packed
    return b"\x89MCAP0\r\n" + struct.pack("<BQ", 6, len(body)) + body


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (chunk(2**62, b"zstd", b"x"), "declares 4611686018427387904 bytes"),
        (chunk(100, b"zstd", zstandard.compress(bytes(2**24))), "its size is not the one declared"),
        (chunk(100, b"zstd", b"nonsense"), "the chunk is damaged"),
        (chunk(100, b"lz4", b"nonsense"), "the chunk is damaged"),
        (chunk(3, b"bz2", b"abc"), "compressed as 'bz2'"),
        (chunk(3, b"", b"abc"), "the last record of the chunk is cut"),
        (chunk(9, b"", struct.pack("<BQ", 5, 2**60)), "a record inside the chunk is"),
        (chunk(31, b"", struct.pack("<BQHIQQ", 5, 22, 7, 0, 0, 0)), "does not introduce"),
        (b"\x89MCAP0\r\n" + struct.pack("<BQ", 9, 2**63), "bytes long, and it is 17"),
        (b"\x89MCAP0\r\n", "cut short"),
    ],
)
def test_chunks_of_a_hostile_hand(home: Path, mapping: Mapped, content: bytes, words: str) -> None:
    (home / "a.mcap").write_bytes(content)
    said = refused(home, home / "a.mcap", mapping(one('topic = "/a", channel = "q"')))
    assert words in said
    assert "a.mcap: byte 8" in said or "byte 17" in said


def test_encodings_that_are_not_read(home: Path, mapping: Mapped) -> None:
    file = write_json_mcap(home / "a.mcap", [(0, {"q": 1})], encoding="cbor")
    said = refused(home, file, mapping(one('topic = "/tool", channel = "q"')))
    assert "'cbor with jsonschema'; read are cdr with ros2msg, json" in said
    assert "read are cdr" in describe_sources([str(file)])


@pytest.mark.parametrize(
    ("messages", "words"),
    [
        ([(0, {"q": 1}), (1, {"q": "two"})], "message 2: 'q' is no number"),
        ([(0, {"q": 1}), (1, b"{")], "message 2: it is damaged"),
        ([(0, {"q": 1}), (1, b"[" * 100000)], "message 2: it is damaged"),
        ([(0, {"q": 1}), (1, b'{"q": 1' + b"0" * 400 + b"}")], "too large a number"),
        ([(0, {"q": 1}), (1, b'{"q": Infinity}')], "message 2: the value is infinite"),
        ([(5, {"q": 1}), (4, {"q": 1})], "message 2: time runs backwards"),
        ([(5, {"q": 1}), (2**63, {"q": 1})], "which is no date"),
        ([(0, [1, 2]), (1, [1])], "has no fields"),
        ([(0, {"w": 1})], "there is no field 'q'; there are 'w'"),
    ],
)
def test_messages_that_cannot_be_used(
    home: Path, mapping: Mapped, messages: list[tuple[int, object]], words: str
) -> None:
    file = write_json_mcap(home / "a.mcap", messages)
    said = refused(home, file, mapping(one('topic = "/tool", channel = "q"')))
    assert words in said
    assert "topic '/tool'" in said


def test_a_message_whose_bytes_do_not_fit_its_type(home: Path, mapping: Mapped) -> None:
    rows = imu(np.arange(20) / 100)
    file = write_ros2(home / "a.mcap", {"/imu": ("sensor_msgs/msg/Imu", IMU, rows)},
                      compression=CompressionType.NONE, enable_crcs=False)  # fmt: skip
    # The length of the frame's name becomes four gigabytes.
    raw = file.read_bytes().replace(b"\x05\0\0\0base\0", b"\xff\xff\xff\xffbase\0")
    file.write_bytes(raw)
    mapped = mapping(one('topic = "/imu", channel = "linear_acceleration.x"'))
    assert "message 1: it is damaged" in refused(home, file, mapped)


def test_a_checksum_that_is_wrong(home: Path, mapping: Mapped) -> None:
    file = write_robot(home / "a.mcap", compression=CompressionType.NONE)
    raw = bytearray(file.read_bytes())
    raw[len(raw) // 3] ^= 1
    file.write_bytes(bytes(raw))
    said = refused(home, file, mapping(one('topic = "/imu", channel = "linear_acceleration.x"')))
    assert "its checksum is not the one declared" in said


def test_histories_that_are_none(home: Path, mapping: Mapped) -> None:
    time = np.arange(64) / 100
    signals = motion(time)
    file = write_uff(home / "v.uff", time, {(1, 1): signals["x"], (1, -1): signals["y"]}, kind=2)
    assert "kind 'auto spectrum', no time history" in refused(
        home, file, mapping(one('channel = "1+X"'))
    )
    file = write_uff(home / "v.uff", time, {(1, 1): signals["x"]})
    said = refused(home, file, mapping(one('channel = "1+Y"')))
    assert "there is no history '1+Y'; there are '1+X'; did you mean '1+X'" in said
    file = write_uff(home / "v.uff", time, {(1, 1): signals["x"]}, unit="NONE")
    text = file.read_text()
    file.write_text(text.replace(text.splitlines()[-3] + "\n", ""))
    said = refused(home, file, mapping(one('channel = "1+X"')))
    assert "64 values declared, 60 there" in said


def test_only_files_of_the_command_line_are_read(home: Path, mapping: Mapped) -> None:
    log = write_csv(home / "log.csv", np.stack([TIME, TIME], 1), ["t", "q"])
    secret = write_csv(home / "secret.csv", np.stack([TIME, TIME], 1), ["t", "q"])
    named = (
        one('channel = "q"', source=f'{CLOCK}\nfile = "{secret}"')
        .replace("[columns]", "[sources.other]\n[columns]")
        .replace("{ channel", '{ source = "s", channel')
    )
    assert "not among those given ('log.csv')" in refused(home, log, mapping(named))
    run = one('channel = "q"', source=CLOCK, run=f'sources = {{ s = "{secret}" }}')
    assert "not among those given ('log.csv')" in refused(home, log, mapping(run))


def test_the_command_line_needs_a_mapping(
    home: Path, mapping: Mapped, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = str(write_robot(home / "robot.mcap"))
    for words in ([], ["--out", "x"], ["--describe", "--out", "x"]):
        with pytest.raises(SystemExit) as ended:
            main(["import", bag, *words])
        assert ended.value.code == 2
    capsys.readouterr()
    told = ["--mapping", str(mapping(one('channel = "q"'))), "--out", str(home / "out")]
    for words, reason in (
        ([str(home / "none.mcap")], "there is no file"),
        ([bag, bag], "two sources are called"),
        ([f"s={bag}", f"more={bag}"], "uses no file 'more'"),
    ):
        assert main(["import", *words, *told]) == 1
        said = capsys.readouterr().err
        assert reason in said
        assert said.count("\n") == 1


def test_late_stamps_are_not_those_of_the_header(home: Path, mapping: Mapped) -> None:
    rows = joint_states(np.arange(50) / 100, late_ns=3_000_000_000)
    kind = {"/joint_states": ("sensor_msgs/msg/JointState", JOINT_STATE, rows)}
    bag = write_ros2(home / "robot.mcap", kind)
    channel = 'topic = "/joint_states", channel = "position[elbow]"'
    stop = 'stop = "2024-05-01T10:00:00.2Z"'
    text = one(channel, source='time = { stamp = "log" }', run=stop)
    assert "is not within" in refused(home, bag, mapping(text))
    for number, source in enumerate(('time = { stamp = "header" }', "")):  # preferred by default
        mapped = mapping(one(channel, source=source, run=stop))
        assert import_recording([bag], mapped, home / f"out{number}").runs[0].samples == 21
